"""Forks of this process that a user's code makes, and that return from it as if they were this process."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def forks_end_here() -> Iterator[None]:
    """End, at the end of the block, every process that was forked within it.

    A fork that returns from a policy would otherwise go on as a second copy of the worker, and answer twice. A fork
    that exits by itself keeps its exit code.
    """
    own = os.getpid()
    try:
        yield
    except SystemExit as end:
        if os.getpid() != own:
            os._exit(_exit_code(end))
        raise
    finally:
        if os.getpid() != own:
            os._exit(1)


def _exit_code(end: SystemExit) -> int:
    """What `sys.exit` makes of its argument."""
    if end.code is None:
        return 0
    return end.code if isinstance(end.code, int) else 1
