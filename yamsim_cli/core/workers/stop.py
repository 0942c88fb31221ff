"""A user's wish that a job end, which the job looks at between two steps."""

from __future__ import annotations

import time


class Stop:
    """Set once, from a signal handler or another thread; never taken back."""

    def __init__(self) -> None:
        self._asked_at: float | None = None

    @property
    def asked(self) -> bool:
        """Whether the job is to end."""
        return self._asked_at is not None

    @property
    def waited(self) -> float:
        """Seconds since it was asked to; 0 if it was not."""
        return 0.0 if self._asked_at is None else time.monotonic() - self._asked_at

    def ask(self) -> None:
        """Ask the job to end."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()
