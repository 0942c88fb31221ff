"""Messages that explain disk errors, with cause and remedy."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from ..files.writing import describe_refusal, nearest_directory

_REMEDIES = {
    errno.EDQUOT: "the quota is used up: free some space, or ask for more",
    errno.EROFS: "mounted read-only, or made read-only after a disk error: see the system log",
    errno.EIO: "the disk or its server failed: see the system log",
    errno.EFBIG: "a limit on file sizes is in force: see ulimit -f",
    errno.ESTALE: "the server no longer knows the file: mount it again",
}


def explain_disk_error(error: OSError, place: Path) -> str:
    """Return the file, cause and remedy of a write error below `place`, as one clause."""
    file = Path(error.filename) if isinstance(error.filename, str) else place
    return f"{file}: {describe_disk_error(error, nearest_directory(file.parent))}"


def describe_disk_error(error: OSError, place: Path) -> str:
    """Return the cause and remedy of an error at `place`, as one clause."""
    if error.errno == errno.ENOSPC:
        return _describe_full_disk(place)
    remedy = _REMEDIES.get(error.errno or 0)
    cause = describe_refusal(error, place)
    return f"{cause}: {remedy}" if remedy else cause


def _describe_full_disk(place: Path) -> str:
    """Say whether bytes or inodes are used up. The kernel reports "no space left" for both."""
    try:
        state = os.statvfs(place)
    except OSError:
        return "no space left on the device: free some space"
    if state.f_files and not state.f_favail:
        return f"no inodes left on the device (all {state.f_files} are in use): delete files, or use another disk"
    free = state.f_bavail * state.f_frsize
    return f"no space left on the device ({free / 1e6:.1f} MB are free): free some space, or use another disk"
