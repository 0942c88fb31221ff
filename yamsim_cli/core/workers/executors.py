from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Generic, Protocol, TypeVar, cast

from ..closable import Closable
from ..errors import PartialJobError

J = TypeVar("J")
R = TypeVar("R")
JobIn = TypeVar("JobIn", contravariant=True)
ResultOut = TypeVar("ResultOut", covariant=True)


class SingleJobRunner(Protocol[JobIn, ResultOut]):
    """Runs single jobs in a worker. It is opened once in the worker's process, and then runs one job after another."""

    def run(self, job: JobIn) -> ResultOut:
        """Return the result of a job, which depends only on the job."""


# Creates the runner of a worker, as a context manager; must be picklable.
OpenRunner = Callable[[], AbstractContextManager[SingleJobRunner[J, R]]]


class WorkerBugError(RuntimeError):
    """A bug in a worker: an exception other than a `YamsimError`. Its text is the worker's traceback."""


class LostJobError(PartialJobError):
    """A job whose every try ended the worker. The executor continues with other jobs.

    `tries` workers tried the job; `reason` is how the last one ended.
    """

    def __init__(self, job: object, tries: int, reason: str) -> None:
        super().__init__(f"{job} was given up after {tries} tries: its worker {reason}")
        self.job = job
        self.tries = tries
        self.reason = reason


class Executor(Closable, Generic[J, R]):
    """Runs jobs, mostly in workers. Closing ends all workers at once, even during a job: they hold no data."""

    @property
    @abstractmethod
    def idle(self) -> int:
        """Number of jobs that can be submitted now."""

    @property
    @abstractmethod
    def in_flight(self) -> int:
        """Number of submitted jobs without a returned result."""

    @abstractmethod
    def submit(self, job: J) -> None:
        """Give a job to an idle worker; requires `idle` above 0."""

    @abstractmethod
    def next_result(self, timeout: float | None = None) -> tuple[J, R]:
        """Wait for the next job that finishes, and return the job and its result.

        Args:
            timeout: s; None for no limit.

        Raises:
            TimeoutError: no job finished in that time.
            YamsimError: the runner raised this error.
            WorkerBugError: the runner raised another exception.
            LostJobError: a job ended every worker that tried it.
            PartialJobError: no worker can be kept alive.
        """


def run_all(
    executor: Executor[J, R], jobs: Iterable[J], lost: Callable[[LostJobError], R] | None = None
) -> Iterator[tuple[J, R]]:
    """Yield every job with its result, in the order in which jobs finish. Raises as `Executor.next_result`.

    `lost` returns a substitute result for a job that ended every worker that tried it; with None, the `LostJobError`
    is raised.
    """
    waiting = iter(jobs)
    while True:
        while executor.idle and (job := next(waiting, None)) is not None:
            executor.submit(job)
        if not executor.in_flight:
            return
        try:
            yield executor.next_result()
        except LostJobError as error:
            if lost is None:
                raise
            yield cast("J", error.job), lost(error)


class InlineExecutor(Executor[J, R]):
    """Runs a job in the caller's process, when the job's result is requested."""

    def __init__(self, factory: OpenRunner[J, R]) -> None:
        self._stack = contextlib.ExitStack()
        self._runner = self._stack.enter_context(factory())
        self._waiting: deque[J] = deque()

    @property
    def idle(self) -> int:
        """See `Executor.idle`."""
        return 1 - len(self._waiting)

    @property
    def in_flight(self) -> int:
        """See `Executor.in_flight`."""
        return len(self._waiting)

    def submit(self, job: J) -> None:
        """Keep a job until its result is requested."""
        self._waiting.append(job)

    def next_result(self, timeout: float | None = None) -> tuple[J, R]:
        """Run the waiting job, and return the job and its result; `timeout` is ignored."""
        job = self._waiting.popleft()
        return job, self._runner.run(job)

    def close(self) -> None:
        """Close the runner."""
        self._stack.close()
