"""The protocols of executors, which turn jobs into results. They know nothing of robots."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Protocol, TypeVar

from ..errors import PartialJobError

J = TypeVar("J")
R = TypeVar("R")
JobIn = TypeVar("JobIn", contravariant=True)
ResultOut = TypeVar("ResultOut", covariant=True)


class Runner(Protocol[JobIn, ResultOut]):
    """What a worker runs. It is opened once in the worker's process, and then runs one job after the other."""

    def run(self, job: JobIn) -> ResultOut:
        """The result of a job, which depends on nothing but the job."""
        ...


# Makes a worker's runner. It has to be picklable.
Factory = Callable[[], AbstractContextManager[Runner[J, R]]]


class WorkerBugError(RuntimeError):
    """An exception in a worker that is no `YamsimError` and so a bug; its text is the worker's own traceback."""


class LostJobError(PartialJobError):
    """A job that ended its worker every time that it was tried. The executor itself goes on.

    Attributes:
        job: the job.
        tries: how often it was tried.
        reason: how its last worker ended.
    """

    def __init__(self, job: object, tries: int, reason: str) -> None:
        super().__init__(f"{job} was given up after {tries} tries: its worker {reason}")
        self.job = job
        self.tries = tries
        self.reason = reason


class Executor(Protocol[J, R]):
    """Workers that run jobs in parallel; a context manager that ends them all."""

    @property
    def idle(self) -> int:
        """How many jobs can be submitted now."""
        ...

    @property
    def in_flight(self) -> int:
        """How many jobs were submitted and have not returned."""
        ...

    def submit(self, job: J) -> None:
        """Give a job to an idle worker; there must be one."""
        ...

    def result(self, timeout: float | None = None) -> tuple[J, R]:
        """The next job that finishes, and its result.

        Args:
            timeout: seconds to wait; None for no limit.

        Raises:
            TimeoutError: none finished in that time.
            YamsimError: the runner raised it.
            WorkerBugError: the runner raised anything else.
            LostJobError: a job ended every worker that it was given to.
            PartialJobError: no worker can be kept alive.
        """
        ...

    def close(self) -> None:
        """End all workers at once, whatever they are doing: none of them holds anything that could be lost."""
        ...

    def __enter__(self) -> Executor[J, R]: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
