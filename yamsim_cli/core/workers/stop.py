"""A request that a job end, which the job checks between two steps."""

from __future__ import annotations

import time


class Stop:
    """A request that is made once, from a signal handler or another thread, and never withdrawn."""

    def __init__(self) -> None:
        self._asked_at: float | None = None

    @property
    def asked(self) -> bool:
        """Whether the job was asked to end."""
        return self._asked_at is not None

    @property
    def waited(self) -> float:
        """Seconds since it was asked to end; 0 if it was not."""
        return 0.0 if self._asked_at is None else time.monotonic() - self._asked_at

    def ask(self) -> None:
        """Ask the job to end."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()
