"""A lock that lets only one recorder at a time into a dataset's directory.

It is an advisory lock of the kernel's (flock) on a file in the directory. So it ends with its process, however that
ends, and the file that a killed process leaves blocks nobody. On Linux it works between machines over NFS. Where a
filesystem has no locks, or keeps them within one machine, the holder that the file names decides.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import socket
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

from ...errors import ResourceError
from ..layout import LOCK

# flock's errors on a filesystem without such locks.
_UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


class _Flock(Enum):
    TAKEN = auto()
    HELD = auto()
    UNSUPPORTED = auto()


@dataclass(frozen=True)
class _Holder:
    pid: int
    host: str

    @property
    def is_here(self) -> bool:
        return self.host == socket.gethostname()

    @property
    def may_live(self) -> bool:
        """Whether the process may still run; on another machine that is always possible."""
        if not self.is_here:
            return True
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return True
        return True


class DirectoryLock:
    """A lock on a directory, held from `take` until `release`, or to the end of the process."""

    def __init__(self, directory: Path, descriptor: int) -> None:
        self._directory = directory
        self._descriptor = descriptor

    @classmethod
    def take(cls, directory: Path, *, reaches_others: bool = True) -> DirectoryLock:
        """The lock on a directory, taken for this process.

        Args:
            directory: must exist.
            reaches_others: whether the filesystem's locks hold between machines. If not, a file that a process on
                another machine left counts as a lock.

        Raises:
            ResourceError: another recorder holds it; the message names its process and machine.
            OSError: the directory cannot be written.
        """
        path = directory / LOCK
        while True:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                flock, holder = _flock(descriptor), _read(descriptor)
                if _forbidden(flock, holder, reaches_others):
                    raise ResourceError(_refusal(path, holder, flock))
                if _is_at(descriptor, path):
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode(), 0)
                    return cls(directory, descriptor)
            except BaseException:
                os.close(descriptor)
                raise
            # Its holder removed the file after it was opened here: it is no longer the directory's lock.
            os.close(descriptor)

    def moved(self, directory: Path) -> None:
        """Note that the directory has been renamed."""
        self._directory = directory

    def release(self) -> None:
        """Release the lock, and remove the file."""
        with contextlib.suppress(OSError):
            (self._directory / LOCK).unlink(missing_ok=True)
        os.close(self._descriptor)


def _flock(descriptor: int) -> _Flock:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return _Flock.HELD
    except OSError as error:
        if error.errno in _UNSUPPORTED:
            return _Flock.UNSUPPORTED
        raise
    return _Flock.TAKEN


def _forbidden(flock: _Flock, holder: _Holder | None, reaches_others: bool) -> bool:
    if flock is _Flock.HELD:
        return True
    if holder is None:
        return False
    if flock is _Flock.UNSUPPORTED:
        return holder.may_live
    return not holder.is_here and not reaches_others


def _refusal(path: Path, holder: _Holder | None, flock: _Flock) -> str:
    who = f"process {holder.pid} on {holder.host}" if holder else "another process"
    if flock is _Flock.HELD:
        return f"{path.parent} is being recorded into by {who}; wait for it, end it, or choose another --out"
    return (
        f"{path.parent} is marked as being recorded into by {who}, and this filesystem's locks cannot tell whether it "
        f"still is; if it has ended, delete {path}"
    )


def _read(descriptor: int) -> _Holder | None:
    """The process that the file names; None if it is empty or incomplete."""
    try:
        data = json.loads(os.pread(descriptor, 4096, 0))
        return _Holder(int(data["pid"]), str(data["host"]))
    except (ValueError, KeyError, TypeError):
        return None


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
