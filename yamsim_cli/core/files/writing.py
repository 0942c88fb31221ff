"""Writes files and directories whole or not at all.

Content is written beside its destination, flushed to the disk, and then renamed. A crash at any moment leaves the old
or the new state under the final name, never half of either.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..errors import ResourceError, UsageError

# Errors of a path, which `obstacle` explains better than the system's text.
_PATH_ERRORS = (errno.EEXIST, errno.ENOTDIR, errno.ENOENT, errno.ELOOP, errno.ENAMETOOLONG)
_FLUSHERS = 16  # threads: each waits for the disk and releases the GIL


def sha256_bytes(data: bytes) -> str:
    """Hex SHA-256 of `data`."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Path) -> str:
    """Hex SHA-256 of a file, read in pieces."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def fsync_directory(path: Path) -> None:
    """Flush a directory's entries, so that a rename in it survives a power cut."""
    with _opened(path, os.O_RDONLY | os.O_DIRECTORY) as descriptor:
        os.fsync(descriptor)


@contextlib.contextmanager
def _opened(path: Path, flags: int) -> Iterator[int]:
    """A descriptor for the block. Errors in the block name the file, unlike errors of `os.read` and `os.write`."""
    descriptor = os.open(path, flags, 0o666)
    try:
        yield descriptor
    except OSError as error:
        error.filename = error.filename or str(path)
        raise
    finally:
        os.close(descriptor)


def _write_and_fsync(path: Path, data: bytes) -> None:
    """Create a file that must not exist."""
    with _opened(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL) as descriptor:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)


def write_file(path: Path, data: bytes) -> None:
    """Replace or create one file atomically; its directory must exist.

    Raises:
        OSError: the file could not be written, and has its old content. If only the last flush, of the directory,
            fails, the file has the new content.
    """
    write_files({path: data})


def write_files(files: Mapping[Path, bytes]) -> None:
    """Replace or create several files: all content is on the disk before the first file gets its name.

    Raises:
        OSError: a file could not be written; no file has changed, unless a rename failed.
    """
    parts = {path: path.with_name(f".{path.name}.{uuid.uuid4().hex}.part") for path in files}
    try:
        for path, part in parts.items():
            _write_and_fsync(part, files[path])
        for path, part in parts.items():
            os.replace(part, path)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
    for folder in {path.parent for path in files}:
        fsync_directory(folder)


def write_output(path: Path, data: bytes, flag: str = "--out") -> None:
    """Write a command's result that is one file, see `write_outputs`."""
    write_outputs({path: data}, flag)


def write_outputs(files: Mapping[Path, bytes], flag: str = "--out", *, make_folder: bool = False) -> None:
    """Write all files of a command's result or none; if that fails, keep the result among the temporary files.

    Args:
        files: path -> content, all in one directory; existing files are replaced.
        flag: the option that names the files, for the message.
        make_folder: make the directory if missing.

    Raises:
        ResourceError: a file cannot be written; the message says where the result is kept.
    """
    folder = next(iter(files)).parent
    try:
        if make_folder:
            folder.mkdir(parents=True, exist_ok=True)
        write_files(files)
    except OSError as error:
        kept = _save_to_temporary({path.name: data for path, data in files.items()})
        raise ResourceError(
            f"{folder if len(files) > 1 else next(iter(files))} cannot be written: {describe_refusal(error, folder)}; "
            f"choose another {flag}" + (f". The result is kept in {kept}" if kept else "")
        ) from error


def _save_to_temporary(files: Mapping[str, bytes]) -> Path | None:
    """Save a result in a new temporary folder; None if that fails too."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="yamsim-"))
        write_files({folder / name: data for name, data in files.items()})
    except OSError:
        return None
    return folder


def publish_file(part: Path, final: Path) -> None:
    """Rename the finished file `part` to `final`, in the same directory; raises as `write_file`, and keeps `part`."""
    _fsync(part)
    os.replace(part, final)
    fsync_directory(final.parent)


def append_line(path: Path, line: str) -> None:
    """Append one line by a single write, and flush it to the disk: a crash leaves a whole line or none.

    A last line without an end, from a power cut, is ended first.
    """
    with _opened(path, os.O_RDWR | os.O_CREAT | os.O_APPEND) as descriptor:
        size = os.fstat(descriptor).st_size
        cut_off = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"
        data = (("\n" if cut_off else "") + line + "\n").encode()
        if os.write(descriptor, data) != len(data):
            os.ftruncate(descriptor, size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(descriptor)


def publish_directory(final: Path, files: Mapping[str, bytes], staging: Path) -> None:
    """Create directory `final` with all of `files` in one step.

    Args:
        final: must not exist; its parent must exist.
        files: relative POSIX path -> content.
        staging: a directory on the same filesystem where the tree is built first; made if missing.

    Raises:
        OSError: nothing appeared under `final`, and the staged tree was removed.
    """
    stage = staging / f"{final.name}.{uuid.uuid4().hex}"
    try:
        stage.mkdir(parents=True)
        directories = {stage}
        for name, data in files.items():
            path = stage / name
            if path.parent not in directories:
                path.parent.mkdir(parents=True, exist_ok=True)
                directories.update(parent for parent in path.parents if stage in parent.parents or parent == stage)
            _write_and_fsync(path, data)
        for directory in directories:
            fsync_directory(directory)
        # rename(2) refuses a non-empty target, and silently replaces an empty directory.
        if final.exists():
            raise FileExistsError(f"{final} already exists")
        os.rename(stage, final)
        try:
            fsync_directory(final.parent)
        except BaseException:
            os.rename(final, stage)
            raise
    except BaseException:
        shutil.rmtree(stage, ignore_errors=True)
        raise


@dataclass
class StagedDirectory:
    """A directory that is being filled.

    Attributes:
        path: where to write.
        moved_aside: after the block, the new place of an earlier directory; None if there was none.
    """

    path: Path
    moved_aside: Path | None = None


@contextlib.contextmanager
def staged_directory(final: Path, *, overwrite: bool = False) -> Iterator[StagedDirectory]:
    """A hidden directory beside `final`, to be filled in the block; then flushed to the disk and renamed to `final`.

    For trees that are too large for `publish_directory`. An exception in the block removes what was written, and the
    next call for the same `final` removes what a killed process left.

    Args:
        overwrite: move what is at `final` aside, after the block.

    Raises:
        UsageError: the process's current directory is `final` or lies in it.
        FileExistsError: `final` exists, and not as an empty directory.
        OSError: the tree could not be written; nothing appeared under `final`.
    """
    final = _named(final)
    _refuse_own_directory(final)
    _remove_stale(final.parent, re.compile(rf"\.{re.escape(final.name)}\.[0-9a-f]{{32}}\.part"))

    def make() -> Path:
        path = final.with_name(f".{final.name}.{uuid.uuid4().hex}.part")
        path.mkdir()
        return path

    with _locked_folder(make) as path:
        yield from _filled(StagedDirectory(path), final, overwrite=overwrite)


def _filled(stage: StagedDirectory, final: Path, *, overwrite: bool) -> Iterator[StagedDirectory]:
    try:
        yield stage
        _fsync_tree(stage.path)
        if final.is_dir() and not any(final.iterdir()):
            final.rmdir()
        if overwrite and os.path.lexists(final):
            stage.moved_aside = move_to_backup(final)
        # rename(2) refuses a non-empty target, and silently replaces a file.
        if final.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(final))
        os.rename(stage.path, final)
        fsync_directory(final.parent)
    except BaseException:
        shutil.rmtree(stage.path, ignore_errors=True)
        raise


@contextlib.contextmanager
def scratch_directory(prefix: str) -> Iterator[Path]:
    """A new temporary folder for the block; folders of killed processes are removed first."""
    _remove_stale(Path(tempfile.gettempdir()), re.compile(rf"{re.escape(prefix)}\w{{8}}"))
    with _locked_folder(lambda: Path(tempfile.mkdtemp(prefix=prefix))) as folder:
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _locked_folder(make: Callable[[], Path]) -> Iterator[Path]:
    """A new folder, locked for the block as a sign that a living process uses it."""
    while True:
        folder = make()
        # Another process may remove the folder as stale before it is locked here: then another folder is made.
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue
        try:
            # On a filesystem without locks, no process removes folders either.
            with contextlib.suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            if folder.exists():
                yield folder
                return
        finally:
            os.close(descriptor)


def _remove_stale(parent: Path, names: re.Pattern[str]) -> None:
    """Remove folders of these names that no process has locked: killed processes left them."""
    for folder in parent.iterdir() if parent.is_dir() else ():
        if not names.fullmatch(folder.name):
            continue
        # Folders of other users, in use, or on a filesystem without locks raise OSError, and stay.
        with contextlib.suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(descriptor).st_uid == os.getuid():
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(descriptor)


def _fsync_tree(root: Path) -> None:
    """Flush all files and directories below `root`, many at a time."""
    paths = [root, *root.rglob("*")]
    with ThreadPoolExecutor(_FLUSHERS) as flushers:
        list(flushers.map(_fsync, paths))


def _fsync(path: Path) -> None:
    with _opened(path, os.O_RDONLY) as descriptor:
        os.fsync(descriptor)


def nearest_directory(path: Path) -> Path:
    """The directory at `path`, or the nearest one above it that exists."""
    # Not Path.is_dir, which raises for names that are too long and directories that may not be read.
    return next(folder for folder in (path, *path.absolute().parents) if os.path.isdir(folder))


def why_not_directory(path: Path) -> str | None:
    """Why no directory can be made at `path`, such as `it is a file`; None if no reason is known."""
    try:
        path.lstat()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return "it is too long: a name may have 255 bytes, and a whole path 4,095"
    for place in (path, *path.parents):
        if os.path.isdir(place):
            return None
        if os.path.lexists(place):
            name = "it" if place == path else str(place)
            if os.path.exists(place):
                return f"{name} is {'a file' if os.path.isfile(place) else 'no directory'}"
            return f"{name} is a link to {os.readlink(place)}, where nothing is"
    return None


def describe_refusal(error: OSError, path: Path) -> str:
    """Why a directory cannot be made or filled at `path`: an error of the system as a clause."""
    found = why_not_directory(path) if error.errno in _PATH_ERRORS else None
    return found or error.strerror or str(error)


def _named(path: Path) -> Path:
    """The same path, resolved if it does not end in a name."""
    return path.resolve() if path.name in ("", "..") else path


def _refuse_own_directory(path: Path) -> None:
    """Raise UsageError if `path` is this process's directory, or contains it."""
    if not path.is_symlink() and Path.cwd().is_relative_to(path.resolve()):
        raise UsageError(
            f"{path} cannot be moved aside, because you are in it: run from another directory, or write elsewhere"
        )


def move_to_backup(path: Path) -> Path:
    """Rename `path` to the first free `<name>.old-<n>` beside it, and return that.

    Raises:
        UsageError: `path` is this process's directory, or contains it: the user's shell is there too.
        OSError: `path` cannot be renamed.
    """
    path = _named(path)
    _refuse_own_directory(path)
    number = 1
    while (target := path.with_name(f"{path.name}.old-{number}")).exists():
        number += 1
    path.rename(target)
    return target


@contextlib.contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Hold an advisory lock on `path`, made if missing, for the block; waits for another holder to finish."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
