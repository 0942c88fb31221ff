"""One recorder at a time in a dataset's directory.

The lock is an advisory one of the kernel's (flock) on a file in the directory, so it ends with its process, however
that ends, and a file left by a killed process blocks nobody. On Linux it reaches over NFS to other machines. Where a
filesystem keeps its locks within one machine, or has none, what the file says of its holder decides.
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

from ..errors import ResourceError
from .layout import LOCK

# What flock says on a filesystem that has no such locks.
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
        """Whether it may still run; of another machine nothing else can be said."""
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
    """Held on a directory from `take` until `release`, or to the end of the process."""

    def __init__(self, directory: Path, descriptor: int) -> None:
        self._directory = directory
        self._descriptor = descriptor

    @classmethod
    def take(cls, directory: Path, *, reaches_others: bool = True) -> DirectoryLock:
        """Take the lock, or say who has it.

        Args:
            directory: must exist.
            reaches_others: whether the filesystem's locks hold between machines; if not, a file that another machine
                left is believed.

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
            # Its holder removed it after we opened it: that one is no longer the directory's lock.
            os.close(descriptor)

    def moved(self, directory: Path) -> None:
        """Say that the directory has been renamed."""
        self._directory = directory

    def release(self) -> None:
        """Let go, and remove the file."""
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
    """Who wrote the file; None if nobody has, or not all of it."""
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
