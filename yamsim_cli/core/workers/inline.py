"""Runs jobs in this process, for notebooks, and for scripts that start no others."""

from __future__ import annotations

import contextlib
from collections import deque
from typing import Generic

from ..closing import Closing
from .executor import Factory, J, R


class InlineExecutor(Closing, Generic[J, R]):
    """An `Executor` that runs a job when its result is asked for, in the caller's process."""

    def __init__(self, factory: Factory[J, R]) -> None:
        self._stack = contextlib.ExitStack()
        self._runner = self._stack.enter_context(factory())
        self._waiting: deque[J] = deque()

    @property
    def idle(self) -> int:
        """1 if no job waits, else 0."""
        return 1 - len(self._waiting)

    @property
    def in_flight(self) -> int:
        """1 if a job waits, else 0."""
        return len(self._waiting)

    def submit(self, job: J) -> None:
        """Keep a job until its result is asked for."""
        self._waiting.append(job)

    def result(self, timeout: float | None = None) -> tuple[J, R]:
        """The job that waits, and its result; `timeout` is ignored."""
        job = self._waiting.popleft()
        return job, self._runner.run(job)

    def close(self) -> None:
        """Close the runner."""
        self._stack.close()
