"""Claims a dataset's directory for a recorder: refuses an occupied one, resumes it, or moves it aside."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from ...errors import UsageError
from ...files import move_aside, obstacle
from ..layout import LOCK, STAGING, is_litter
from .directory_lock import DirectoryLock


class OpenMode(Enum):
    """What to do when the dataset's directory already holds something."""

    NEW = "new"
    RESUME = "resume"
    OVERWRITE = "overwrite"


@dataclass(frozen=True)
class Claim:
    """A directory that this process may write.

    Attributes:
        lock: keeps other recorders out until it is released.
        occupied: whether it holds a dataset to be resumed.
        moved_aside: the new place of what was there before, if it was moved.
    """

    lock: DirectoryLock
    occupied: bool
    moved_aside: Path | None


def claim(path: Path, mode: OpenMode, *, locks_reach_others: bool) -> Claim:
    """The claim on a directory, which is made when missing and locked.

    Raises:
        UsageError: it is not empty, or is no directory, and the mode does not say what to do.
        ResourceError: another recorder holds it.
        OSError: it cannot be made or written.
    """
    moved = None
    if mode is OpenMode.OVERWRITE and is_occupied(path):
        moved = _move_aside(path, locks_reach_others)
    if mode is OpenMode.NEW and is_occupied(path):
        # If another recorder is at work there, the error says so and names it, which helps more than "is not empty".
        if (path / LOCK).exists():
            DirectoryLock.take(path, reaches_others=locks_reach_others).release()
        raise _in_the_way(path)
    if not path.is_dir() and is_occupied(path):
        raise UsageError(f"{path} is no dataset to resume: {obstacle(path)}; choose another --out")
    path.mkdir(parents=True, exist_ok=True)
    lock = DirectoryLock.take(path, reaches_others=locks_reach_others)
    try:
        # Asked again, now that nobody else can write.
        occupied = is_occupied(path)
        if occupied and mode is not OpenMode.RESUME:
            raise _in_the_way(path)
        _remove_litter(path)
        return Claim(lock, occupied, moved)
    except BaseException:
        lock.release()
        raise


def is_occupied(path: Path) -> bool:
    """Whether there is anything at `path` besides an empty directory, or the remains of a dataset without content."""
    if not path.is_dir():
        return path.exists() or path.is_symlink()
    return any(not is_litter(entry.name) for entry in path.iterdir())


def _in_the_way(path: Path) -> UsageError:
    if path.is_dir():
        return UsageError(
            f"{path} is not empty; continue it with --resume, move it aside with --overwrite, or choose another --out"
        )
    return UsageError(
        f"{path} is not a directory: {obstacle(path)}; move it aside with --overwrite, or choose another --out"
    )


def _move_aside(path: Path, locks_reach_others: bool) -> Path:
    """The new place of what is at `path`, which is moved unless somebody records into it."""
    if not path.is_dir() or not os.access(path, os.W_OK):
        # Nobody can be recording into that.
        return move_aside(path)
    lock = DirectoryLock.take(path, reaches_others=locks_reach_others)
    try:
        moved = move_aside(path)
        lock.moved(moved)
        return moved
    finally:
        lock.release()


def _remove_litter(path: Path) -> None:
    for entry in path.iterdir():
        if entry.name == STAGING:
            shutil.rmtree(entry, ignore_errors=True)
        elif is_litter(entry.name) and entry.name != LOCK:
            entry.unlink()
