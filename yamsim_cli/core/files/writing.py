"""Writes files and directories atomically.

Content is written beside its destination, flushed to the disk, and then renamed. A crash at any time leaves either the
complete old or the complete new state under the final name.
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

# Errors of a path, for which `directory_obstacle` gives a clearer reason than the system's text.
_PATH_ERRORS = (errno.EEXIST, errno.ENOTDIR, errno.ENOENT, errno.ELOOP, errno.ENAMETOOLONG)
_FLUSH_THREADS = 16  # each waits for the disk and releases the GIL


def sha256_bytes(data: bytes) -> str:
    """Return the SHA-256 in hex."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file in hex; reads the file in pieces."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def fsync_directory(path: Path) -> None:
    """Flush a directory's entries, so that a rename in it survives a power cut."""
    with _open_descriptor(path, os.O_RDONLY | os.O_DIRECTORY) as descriptor:
        os.fsync(descriptor)


@contextlib.contextmanager
def _open_descriptor(path: Path, flags: int) -> Iterator[int]:
    """Open a file for the block. Errors in the block name the file, unlike errors of `os.read` and `os.write`."""
    descriptor = os.open(path, flags, 0o666)
    try:
        yield descriptor
    except OSError as error:
        error.filename = error.filename or str(path)
        raise
    finally:
        os.close(descriptor)


def write_and_fsync(path: Path, data: bytes) -> None:
    """Create a file; raise FileExistsError if it exists."""
    with _open_descriptor(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL) as descriptor:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)


def write_file(path: Path, data: bytes) -> None:
    """Replace or create one file atomically; its directory must exist.

    After an OSError, the file keeps its old content, unless only the last flush (of the directory) failed.
    """
    write_files({path: data})


def write_files(files: Mapping[Path, bytes]) -> None:
    """Replace or create several files; the first rename follows after all content is on the disk.

    After an OSError, no file has changed, unless a rename failed.
    """
    parts = {path: path.with_name(f".{path.name}.{uuid.uuid4().hex}.part") for path in files}
    try:
        for path, part in parts.items():
            write_and_fsync(part, files[path])
        for path, part in parts.items():
            os.replace(part, path)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
    for folder in {path.parent for path in files}:
        fsync_directory(folder)


def write_output(path: Path, data: bytes, flag: str = "--out") -> None:
    """Write the only output file of a command, as `write_outputs`."""
    write_outputs({path: data}, flag)


def write_outputs(files: Mapping[Path, bytes], flag: str = "--out", *, make_folder: bool = False) -> None:
    """Write all output files of a command or none; on failure, save the result in a temporary folder.

    The message of the ResourceError contains the temporary folder.

    Args:
        files: path -> content, all in one directory; existing files are replaced.
        flag: the option for the output path, for the message.
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
    try:
        folder = Path(tempfile.mkdtemp(prefix="yamsim-"))
        write_files({folder / name: data for name, data in files.items()})
    except OSError:
        return None
    return folder


def publish_file(part: Path, final: Path) -> None:
    """Rename the complete file `part` to `final` in the same directory. Raises as `write_file`, and keeps `part`."""
    _fsync_file(part)
    os.replace(part, final)
    fsync_directory(final.parent)


def append_line(path: Path, line: str) -> None:
    """Append one line with a single write, and flush it to the disk: a crash leaves the whole line or none of it.

    If a power cut left an incomplete last line, the function first ends that line.
    """
    with _open_descriptor(path, os.O_RDWR | os.O_CREAT | os.O_APPEND) as descriptor:
        size = os.fstat(descriptor).st_size
        cut_off = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"
        data = (("\n" if cut_off else "") + line + "\n").encode()
        if os.write(descriptor, data) != len(data):
            os.ftruncate(descriptor, size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(descriptor)


def publish_directory(final: Path, files: Mapping[str, bytes], staging: Path) -> None:
    """Create directory `final`, which must not exist, with all `files` in one step.

    After an OSError, `final` does not exist, and the staged tree is removed.

    Args:
        files: relative POSIX path -> content.
        staging: a directory on the same filesystem, where the tree is built first; created if missing.
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
            write_and_fsync(path, data)
        for directory in directories:
            fsync_directory(directory)
        # rename(2) refuses a non-empty target, but silently replaces an empty directory.
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
    """A directory that a block of `staged_directory` fills.

    Attributes:
        path: the hidden temporary directory to write to, which is renamed after the block.
        moved_aside: after the block, the backup of an earlier directory.
    """

    path: Path
    moved_aside: Path | None = None


@contextlib.contextmanager
def staged_directory(final: Path, *, overwrite: bool = False) -> Iterator[StagedDirectory]:
    """Yield a hidden directory beside `final`; after the block, flush it to the disk and rename it to `final`.

    It serves trees that are too large for `publish_directory`. An exception in the block removes the directory. The
    next call for the same `final` removes directories of killed processes. With `overwrite`, an existing `final`
    becomes a backup.

    Raises:
        UsageError: the process's current directory is `final` or lies in `final`.
        FileExistsError: `final` exists, and is not an empty directory.
        OSError: the tree could not be written; `final` is not created.
    """
    final = _resolve_unnamed(final)
    _refuse_own_directory(final)
    _remove_unlocked_folders(final.parent, re.compile(rf"\.{re.escape(final.name)}\.[0-9a-f]{{32}}\.part"))

    def make() -> Path:
        path = final.with_name(f".{final.name}.{uuid.uuid4().hex}.part")
        path.mkdir()
        return path

    with _create_locked_folder(make) as path:
        yield from _sync_and_rename(StagedDirectory(path), final, overwrite=overwrite)


def _sync_and_rename(stage: StagedDirectory, final: Path, *, overwrite: bool) -> Iterator[StagedDirectory]:
    try:
        yield stage
        _fsync_tree(stage.path)
        if final.is_dir() and not any(final.iterdir()):
            final.rmdir()
        if overwrite and os.path.lexists(final):
            stage.moved_aside = move_to_backup(final)
        # rename(2) refuses a non-empty target, but silently replaces a file.
        if final.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(final))
        os.rename(stage.path, final)
        fsync_directory(final.parent)
    except BaseException:
        shutil.rmtree(stage.path, ignore_errors=True)
        raise


@contextlib.contextmanager
def scratch_directory(prefix: str) -> Iterator[Path]:
    """Yield a new temporary folder for the block; first remove folders of killed processes."""
    _remove_unlocked_folders(Path(tempfile.gettempdir()), re.compile(rf"{re.escape(prefix)}\w{{8}}"))
    with _create_locked_folder(lambda: Path(tempfile.mkdtemp(prefix=prefix))) as folder:
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _create_locked_folder(make: Callable[[], Path]) -> Iterator[Path]:
    """Yield a new folder, whose lock marks it as in use."""
    while True:
        folder = make()
        # Before this process locks the folder, another one may remove it as a leftover. Then create another.
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


def _remove_unlocked_folders(parent: Path, names: re.Pattern[str]) -> None:
    """Remove unlocked folders with matching names, which killed processes left behind."""
    for folder in parent.iterdir() if parent.is_dir() else ():
        if not names.fullmatch(folder.name):
            continue
        # Folders of other users, locked folders, and folders on a filesystem without locks raise OSError, and stay.
        with contextlib.suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(descriptor).st_uid == os.getuid():
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(descriptor)


def _fsync_tree(root: Path) -> None:
    paths = [root, *root.rglob("*")]
    with ThreadPoolExecutor(_FLUSH_THREADS) as flushers:
        list(flushers.map(_fsync_file, paths))


def _fsync_file(path: Path) -> None:
    with _open_descriptor(path, os.O_RDONLY) as descriptor:
        os.fsync(descriptor)


def nearest_directory(path: Path) -> Path:
    """Return the directory at `path`, or its nearest existing ancestor."""
    # Path.is_dir raises for too long names and for unreadable directories.
    return next(folder for folder in (path, *path.absolute().parents) if os.path.isdir(folder))


def directory_obstacle(path: Path) -> str | None:
    """Return why no directory can be created at `path`, such as `it is a file`; None if unknown."""
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
                return f"{name} is {'a file' if os.path.isfile(place) else 'not a directory'}"
            return f"{name} is a link to {os.readlink(place)}, which does not exist"
    return None


def describe_refusal(error: OSError, path: Path) -> str:
    """Return, as a clause, why a directory cannot be created or filled at `path`."""
    found = directory_obstacle(path) if error.errno in _PATH_ERRORS else None
    return found or error.strerror or str(error)


def _resolve_unnamed(path: Path) -> Path:
    return path.resolve() if path.name in ("", "..") else path


def _refuse_own_directory(path: Path) -> None:
    if not path.is_symlink() and Path.cwd().is_relative_to(path.resolve()):
        raise UsageError(
            f"{path} cannot be moved aside, because you are in it: run from another directory, or write elsewhere"
        )


def move_to_backup(path: Path) -> Path:
    """Rename `path` to the first free `<name>.old-<n>` beside it, and return the new path.

    UsageError is raised if `path` is or contains the current directory of this process, and so of the user's shell.
    """
    path = _resolve_unnamed(path)
    _refuse_own_directory(path)
    number = 1
    while (target := path.with_name(f"{path.name}.old-{number}")).exists():
        number += 1
    path.rename(target)
    return target


@contextlib.contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Hold an advisory lock on `path`, created if missing, for the block; wait for other holders."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
