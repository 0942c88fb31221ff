"""Processes that foreign code forks off, and that come back from it as if they were this one."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def forks_end_here() -> Iterator[None]:
    """End, at the end of the block, every process that was forked off within it.

    A fork that returns from a policy would go on as its worker: run the trial a second time and answer for it. Its
    parent alone may do that. A fork that exits by itself keeps its exit code.
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
