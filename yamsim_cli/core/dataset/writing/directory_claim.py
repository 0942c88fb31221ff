"""Claim a dataset directory for a recorder: lock it, and refuse, resume or back up existing content.

The lock is an advisory kernel lock (flock) on a file in the directory. The lock ends with its process, so the file of a
killed process blocks no other recorder. On Linux the lock works between machines over NFS. Some filesystems have no
locks, or only locks within one machine. On these, the process that the file names counts as the holder.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import shutil
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from ...config.mesh_provenance import ShownMeshes, describe_mesh_content, describe_remedy, mesh_differences
from ...errors import ConfigError, ResourceError, UsageError
from ...files.documents.yaml_document import load_yaml
from ...files.writing import directory_obstacle, move_to_backup
from ..dataset_paths import CONFIG_FILE, LOCK_FILE_NAME, STAGING_FOLDER, is_leftover

# Errors that flock raises on filesystems without locks.
_NO_FLOCK_ERRORS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)
MESHES_KEY = (
    "meshes"  # config key with the rendered meshes; set by `core.scene.build.with_mesh_descriptions`, not by users
)
_MAX_SHOWN_CHANGES = 5  # changes that a message lists, so that its line stays readable


class ExistingDatasetMode(Enum):
    """What to do if the dataset directory is not empty."""

    NEW = "new"
    RESUME = "resume"
    OVERWRITE = "overwrite"


@dataclass(frozen=True)
class ClaimedDirectory:
    """A directory that this process has locked for writing.

    Attributes:
        lock: keeps other recorders out until it is released.
        occupied: whether the directory holds a dataset to resume.
        moved_aside: path of the backup of an earlier directory; None if no directory was moved.
    """

    lock: DirectoryLock
    occupied: bool
    moved_aside: Path | None


def claim_directory(path: Path, mode: ExistingDatasetMode, *, locks_reach_others: bool) -> ClaimedDirectory:
    """Lock a directory, and create it if missing. `locks_reach_others`: whether locks work between machines.

    Raises:
        UsageError: `path` is not empty, or not a directory, and `mode` does not allow that.
        ResourceError: another recorder holds the directory.
        OSError: the directory cannot be created or written.
    """
    moved = None
    if mode is ExistingDatasetMode.OVERWRITE and _is_occupied(path):
        moved = _move_to_backup(path, locks_reach_others)
    if mode is ExistingDatasetMode.NEW and _is_occupied(path):
        # An error that names the other recorder is more useful than "is not empty".
        if (path / LOCK_FILE_NAME).exists():
            DirectoryLock.acquire(path, reaches_others=locks_reach_others).release()
        raise _occupied_error(path)
    if not path.is_dir() and _is_occupied(path):
        raise UsageError(f"{path} is not a dataset to resume: {directory_obstacle(path)}; choose another --out")
    path.mkdir(parents=True, exist_ok=True)
    lock = DirectoryLock.acquire(path, reaches_others=locks_reach_others)
    try:
        # Check again, now that no other recorder can write.
        occupied = _is_occupied(path)
        if occupied and mode is not ExistingDatasetMode.RESUME:
            raise _occupied_error(path)
        _remove_leftovers(path)
        return ClaimedDirectory(lock, occupied, moved)
    except BaseException:
        lock.release()
        raise


def _is_occupied(path: Path) -> bool:
    """Return whether `path` exists and is not an empty directory. `is_leftover` files do not count."""
    if not path.is_dir():
        return path.exists() or path.is_symlink()
    return any(not is_leftover(entry.name) for entry in path.iterdir())


def _occupied_error(path: Path) -> UsageError:
    if path.is_dir():
        return UsageError(
            f"{path} is not empty; continue it with --resume, move it aside with --overwrite, or choose another --out"
        )
    return UsageError(
        f"{path} is not a directory: {directory_obstacle(path)}; move it aside with --overwrite, or "
        "choose another --out"
    )


def _move_to_backup(path: Path, locks_reach_others: bool) -> Path:
    if not path.is_dir() or not os.access(path, os.W_OK):
        # No recorder can write here, so no lock is needed.
        return move_to_backup(path)
    lock = DirectoryLock.acquire(path, reaches_others=locks_reach_others)
    try:
        moved = move_to_backup(path)
        lock.note_rename(moved)
        return moved
    finally:
        lock.release()


def _remove_leftovers(path: Path) -> None:
    for entry in path.iterdir():
        if entry.name == STAGING_FOLDER:
            shutil.rmtree(entry, ignore_errors=True)
        elif is_leftover(entry.name) and entry.name != LOCK_FILE_NAME:
            entry.unlink()


@dataclass(frozen=True)
class _LockHolder:
    pid: int
    host: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"

    @property
    def is_local(self) -> bool:
        return self.host == socket.gethostname()

    @property
    def may_be_alive(self) -> bool:
        if self.is_local:
            try:
                os.kill(self.pid, 0)
            except ProcessLookupError:
                return False
            except PermissionError:
                pass
        return True


class DirectoryLock:
    """A lock on a directory or a file in it, held from `acquire` until `release` or the end of the process."""

    def __init__(self, directory: Path, descriptor: int, name: str = LOCK_FILE_NAME) -> None:
        self._directory = directory
        self._descriptor = descriptor
        self._name = name

    @classmethod
    def acquire(
        cls, directory: Path, *, reaches_others: bool = True, name: str = LOCK_FILE_NAME, used: str | None = None
    ) -> DirectoryLock:
        """Lock an existing directory for this process.

        Args:
            name: of the lock file; another one locks a part of the directory.
            used: what is locked, and how it is used, for the message; by default, that `directory` is recorded into.
            reaches_others: whether the filesystem's locks work between machines. If not, the lock file of a process on
                another machine counts as a lock.

        Raises:
            ResourceError: another recorder holds the lock; the message names its process and machine.
            OSError: the directory cannot be written.
        """
        path = directory / name
        while True:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                taken, holder = _try_flock(descriptor), _read_lock_holder(descriptor)
                if taken is False:
                    raise ResourceError(
                        f"{used or f'{directory} is being recorded into'} by {holder or 'another process'}; wait for "
                        "it, end it, or choose another --out"
                    )
                if holder and (holder.may_be_alive if taken is None else not holder.is_local and not reaches_others):
                    raise ResourceError(
                        f"{directory} is locked by {holder}, and this filesystem does not show whether the process "
                        f"still runs; if it has ended, delete {path}"
                    )
                if _is_same_file(descriptor, path):
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode(), 0)
                    return cls(directory, descriptor, name)
            except BaseException:
                os.close(descriptor)
                raise
            # The holder removed the file after this process opened it, so the open file is no longer the lock.
            os.close(descriptor)

    def note_rename(self, directory: Path) -> None:
        """Store the new path `directory` of the locked directory, after a rename."""
        self._directory = directory

    def release(self) -> None:
        """Release the lock and remove its file."""
        with contextlib.suppress(OSError):
            (self._directory / self._name).unlink(missing_ok=True)
        os.close(self._descriptor)


def _try_flock(descriptor: int) -> bool | None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in _NO_FLOCK_ERRORS:
            return None
        raise
    return True


def _read_lock_holder(descriptor: int) -> _LockHolder | None:
    try:
        data = json.loads(os.pread(descriptor, 4096, 0))
        return _LockHolder(int(data["pid"]), str(data["host"]))
    except (ValueError, KeyError, TypeError):
        return None


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def require_same_config(dataset: Path, recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Raise ConfigError if the recorded configuration or meshes differ from the resumed recording's."""
    changed = _config_differences(recorded, wanted)
    there, now = _meshes_in_config(recorded), _meshes_in_config(wanted)
    meshes = mesh_differences(there, now)
    if changed:
        changed += [f"{MESHES_KEY}.{text}" for text in meshes]
        more = f"; and {len(changed) - _MAX_SHOWN_CHANGES} more" if len(changed) > _MAX_SHOWN_CHANGES else ""
        raise ConfigError(
            f"{dataset} was recorded with another configuration: {'; '.join(changed[:_MAX_SHOWN_CHANGES])}{more}; "
            f"run with the same values (--config {dataset / CONFIG_FILE} has them), or record into another --out"
        )
    if meshes:
        raise ConfigError(
            f"{dataset} was recorded with other meshes: {'; '.join(meshes)}; {describe_remedy(there, now)}, "
            "or record into another --out"
        )


def describe_unstated_meshes(dataset: Path, wanted: Mapping[str, Any]) -> str:
    """Return a message: the dataset does not state which meshes its images show, and how to find out."""
    texts = ", ".join(f"{name}: {describe_mesh_content(text)}" for name, text in _meshes_in_config(wanted).items())
    return (
        f"{dataset / CONFIG_FILE} does not name the meshes of the episodes, because an earlier yamsim recorded them. "
        "New "
        f"episodes show {texts}; `yamsim verify {dataset} --sample 1 --images` shows whether the meshes are the same."
    )


def recorded_meshes(dataset: Path) -> ShownMeshes:
    """Return asset set -> description of the meshes in a dataset's images, from its config; empty if unreadable."""
    try:
        return _meshes_in_config(load_yaml(dataset / CONFIG_FILE).data)
    except ConfigError:
        return {}


def _meshes_in_config(config: Mapping[str, Any]) -> ShownMeshes:
    stated = config.get(MESHES_KEY)
    return {str(name): str(text) for name, text in stated.items()} if isinstance(stated, Mapping) else {}


def _config_differences(recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    old, new = (
        _flatten_keys({key: value for key, value in data.items() if key != MESHES_KEY}) for data in (recorded, wanted)
    )
    return [
        f"{key}: {old.get(key)!r} there, {new.get(key)!r} now"
        for key in dict.fromkeys([*old, *new])
        if old.get(key) != new.get(key)
    ]


def _flatten_keys(data: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(data, dict):
        return {
            key: value
            for name, inner in data.items()
            for key, value in _flatten_keys(inner, f"{prefix}.{name}" if prefix else name).items()
        }
    if isinstance(data, list | tuple):
        return {
            key: value for k, inner in enumerate(data) for key, value in _flatten_keys(inner, f"{prefix}[{k}]").items()
        }
    return {prefix: data}
