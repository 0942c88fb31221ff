from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StopRequest:
    """A request to end a job, which the job checks between two steps.

    A signal handler or another thread makes the request; no request is withdrawn. A signal handler asks
    `postpone_interrupt` whether a later signal may interrupt the job immediately.
    """

    def __init__(self) -> None:
        self._asked_at: float | None = None
        self._in_block = False
        self._interrupt_waits = False

    @property
    def is_requested(self) -> bool:
        """Whether the end of the job is requested."""
        return self._asked_at is not None

    @property
    def seconds_since_request(self) -> float:
        """Seconds since the request; 0 without one."""
        return 0.0 if self._asked_at is None else time.monotonic() - self._asked_at

    def request_stop(self) -> None:
        """Request the end of the job."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()

    def postpone_interrupt(self) -> bool:
        """Note an interrupt, and return whether it waits for the end of an `uninterrupted` block.

        Only one interrupt waits, so that another one can end a block that hangs.
        """
        if not self._in_block or self._interrupt_waits:
            return False
        self._interrupt_waits = True
        return True

    @contextmanager
    def uninterrupted(self) -> Iterator[None]:
        """Let the first interrupt in the `with` block raise KeyboardInterrupt at the end of the block.

        If the block raises another exception, that one counts, and the interrupt is forgotten.
        """
        self._interrupt_waits, self._in_block = False, True
        try:
            yield
        finally:
            self._in_block = False
        if self._interrupt_waits:
            raise KeyboardInterrupt
