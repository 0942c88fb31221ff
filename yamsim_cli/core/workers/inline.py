"""Jobs run in this very process: for a notebook, or a script that starts no others."""

from __future__ import annotations

import contextlib
from collections import deque
from types import TracebackType
from typing import Generic

from .executor import Factory, J, R


class InlineExecutor(Generic[J, R]):
    """An `Executor` that runs a job when its result is asked for, in the process of the caller."""

    def __init__(self, factory: Factory[J, R]) -> None:
        self._stack = contextlib.ExitStack()
        self._runner = self._stack.enter_context(factory())
        self._waiting: deque[J] = deque()

    @property
    def idle(self) -> int:
        """One job can wait."""
        return 1 - len(self._waiting)

    @property
    def in_flight(self) -> int:
        """Whether one waits."""
        return len(self._waiting)

    def submit(self, job: J) -> None:
        """Keep a job for later."""
        self._waiting.append(job)

    def result(self, timeout: float | None = None) -> tuple[J, R]:
        """Run the job that waits; it takes as long as it takes."""
        job = self._waiting.popleft()
        return job, self._runner.run(job)

    def close(self) -> None:
        """Close the runner."""
        self._stack.close()

    def __enter__(self) -> InlineExecutor[J, R]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
