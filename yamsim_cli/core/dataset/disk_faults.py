"""Explains an error of the disk: why it came, and what to do."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from ..files import nearest_directory, refusal

_MEANING = {
    errno.EDQUOT: "the quota is used up: free some, or ask for more",
    errno.EROFS: "mounted so, or turned so by an error of the disk: see the system's log",
    errno.EIO: "the disk or its server failed: see the system's log",
    errno.EFBIG: "a limit on file sizes is in force: see ulimit -f",
    errno.ESTALE: "the server no longer knows the file: mount it again",
}


def explain(error: OSError, place: Path) -> str:
    """One clause on an error met while writing below `place`: which file, why, and what to do."""
    file = Path(error.filename) if isinstance(error.filename, str) else place
    return f"{file}: {reason(error, nearest_directory(file.parent))}"


def reason(error: OSError, place: Path) -> str:
    """One clause on why an error came at `place`, and what to do."""
    if error.errno == errno.ENOSPC:
        return _what_is_full(place)
    meaning = _MEANING.get(error.errno or 0)
    plain = refusal(error, place)
    return f"{plain}: {meaning}" if meaning else plain


def _what_is_full(place: Path) -> str:
    """Whether bytes or inodes have run out: the kernel says "no space left" for both."""
    try:
        state = os.statvfs(place)
    except OSError:
        return "no space left on the device: free some"
    if state.f_files and not state.f_favail:
        return f"no inodes left on the device (all {state.f_files} are in use): delete files, or use another disk"
    free = state.f_bavail * state.f_frsize
    return f"no space left on the device ({free / 1e6:.1f} MB are free): free some, or use another disk"
