"""The official source: MuJoCo Menagerie's own package, when the user has installed it."""

from __future__ import annotations

import importlib.util
import socket
import sys
import threading
import urllib.parse
from dataclasses import dataclass
from pathlib import Path

from .child import run_child
from .lock import AssetSet
from .sources import FetchProgress, SourceError
from .store import FileStatus, check_file


@dataclass(frozen=True)
class Menagerie:
    """The optional package `mujoco-menagerie`, used through its public API only.

    The package's own settings apply: a `MENAGERIE_ROOT` checkout or a model in its cache is read without any network.

    Attributes:
        probe_s: longest time for its host to accept a connection; after it, the host counts as out of reach.
        limit_s: longest time for its download. It would retry for minutes on a network that swallows packets.
    """

    probe_s: float = 2.0
    limit_s: float = 90.0

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""
        return "mujoco-menagerie"

    def offers(self, assets: AssetSet) -> bool:
        """Whether Menagerie has the model these meshes belong to."""
        return assets.menagerie is not None

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """File name -> content of the locked files, picked out of the model that the package gives.

        Raises:
            SourceError: the package is not installed, its host is out of reach, or its model has other files.
        """
        if assets.menagerie is None:
            raise SourceError(f"no model for {assets.name}")
        if importlib.util.find_spec("mujoco_menagerie") is None:
            raise SourceError("not installed")
        host = _host_needed(assets.menagerie)
        if host is not None and not _answers(host, self.probe_s):
            raise SourceError(f"{host[0]} does not answer within {self.probe_s:g} s")
        label = f"{assets.name}: {self.name}"
        progress(label, 0, assets.size)
        # Its command line rather than a call: a process can be ended when the limit is reached, a thread cannot. -P
        # keeps files in the current folder from being imported.
        command = [sys.executable, "-P", "-m", "mujoco_menagerie", "path", assets.menagerie]
        result = run_child(command, scratch, limit_s=self.limit_s, idle_s=self.limit_s)
        if result.returncode != 0:
            raise SourceError((result.stderr.strip().splitlines() or ["failed without a word"])[-1][:300])
        found = _pick(assets, Path(result.stdout.strip()))
        progress(label, assets.size, assets.size)
        return found


def _host_needed(model: str) -> tuple[str, int] | None:
    """The host and port the package would download `model` from; None when it has the model, or a local base URL."""
    import mujoco_menagerie

    try:
        cache, robot = mujoco_menagerie.Cache(), mujoco_menagerie.get(model)
        if cache.root is not None or cache.is_cached(robot):
            return None
        url = urllib.parse.urlsplit(cache.base_url)
    except (AttributeError, LookupError, mujoco_menagerie.MenagerieError) as error:
        raise SourceError(f"this version of the package does not fit: {error}") from error
    if url.hostname is None:
        return None
    return url.hostname, url.port or (80 if url.scheme == "http" else 443)


def _answers(host: tuple[str, int], timeout_s: float) -> bool:
    """Whether `host` accepts a TCP connection in time.

    Behind a proxy it does not, and this source is skipped. The next one goes through the proxy by itself.
    """
    connected = threading.Event()

    def connect() -> None:
        try:
            socket.create_connection(host, timeout_s).close()
        except OSError:
            return
        connected.set()

    # In a thread, because a socket's timeout does not cover the name lookup.
    thread = threading.Thread(target=connect, daemon=True)
    thread.start()
    thread.join(timeout_s)
    return connected.is_set()


def _pick(assets: AssetSet, tree: Path) -> dict[str, bytes]:
    """The locked files, found by content, so that Menagerie may rename its files and folders."""
    by_size: dict[int, list[Path]] = {}
    for path in sorted(tree.rglob("*")):
        if path.is_file():
            by_size.setdefault(path.stat().st_size, []).append(path)
    found: dict[str, bytes] = {}
    for name, locked in assets.files.items():
        for path in by_size.get(locked.size, []):
            if check_file(path, locked) is FileStatus.OK:
                found[name] = path.read_bytes()
                break
        else:
            raise SourceError(f"its {assets.menagerie} in {tree} has no file with the locked content of {name}")
    return found
