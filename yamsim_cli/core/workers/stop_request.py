from __future__ import annotations

import time


class StopRequest:
    """A request to end a job, which the job checks between two steps.

    A signal handler or another thread makes the request; no request is withdrawn.
    """

    def __init__(self) -> None:
        self._asked_at: float | None = None

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
