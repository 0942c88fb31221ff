"""Processes that turn jobs into results. Knows nothing of robots: each process makes a runner and asks it job by job.

Each worker has a pipe of its own, so one that dies takes nothing with it but the job in its hands, and each ends by
itself when its pipe closes, also when the parent is gone. They are spawned, never forked: a fork would share OpenGL.
"""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Generic, Protocol, TypeVar

from ..errors import PartialJobError, YamsimError

J = TypeVar("J")
R = TypeVar("R")
JobIn = TypeVar("JobIn", contravariant=True)
ResultOut = TypeVar("ResultOut", covariant=True)

_JOIN_SECONDS = 5.0


class Runner(Protocol[JobIn, ResultOut]):
    """What a worker runs: opened once in its process, then asked for one job after the other."""

    def run(self, job: JobIn) -> ResultOut:
        """The result of a job; it depends on nothing else."""
        ...


# Makes a worker's runner; has to be picklable.
Factory = Callable[[], AbstractContextManager[Runner[J, R]]]


class WorkerBugError(RuntimeError):
    """An exception in a worker that is no `YamsimError`: a bug. Carries the worker's own traceback."""


@dataclass
class _Worker(Generic[J]):
    process: BaseProcess
    pipe: Connection
    job: J | None = None


class WorkerPool(Generic[J, R]):
    """A fixed number of worker processes; a context manager that ends them all.

    Args:
        factory: makes each worker's runner, in the worker's process; has to be picklable.
        workers: how many.
    """

    def __init__(self, factory: Factory[J, R], workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._workers: list[_Worker[J]] = []
        for number in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(
                target=_serve, args=(theirs, factory), name=f"yamsim-worker-{number}", daemon=True
            )
            process.start()
            # Only the worker may hold its end, or the pipe would not close when it dies.
            theirs.close()
            self._workers.append(_Worker(process, ours))
        self._ready: deque[tuple[J, R]] = deque()

    @property
    def idle(self) -> int:
        """How many workers have no job."""
        return sum(worker.job is None for worker in self._workers)

    @property
    def in_flight(self) -> int:
        """How many jobs are being worked on."""
        return len(self._workers) - self.idle

    def submit(self, job: J) -> None:
        """Give a job to an idle worker; there has to be one."""
        worker = next(worker for worker in self._workers if worker.job is None)
        worker.job = job
        try:
            worker.pipe.send(job)
        except OSError as error:
            raise self._lost(worker) from error

    def result(self) -> tuple[J, R]:
        """Wait for a job to finish.

        Raises:
            YamsimError: the runner raised it.
            WorkerBugError: the runner raised anything else.
            PartialJobError: the worker died.
        """
        while not self._ready:
            busy = {worker.pipe: worker for worker in self._workers if worker.job is not None}
            for pipe in wait(list(busy)):
                self._receive(busy[pipe])  # type: ignore[index]
        return self._ready.popleft()

    def _receive(self, worker: _Worker[J]) -> None:
        try:
            answer = worker.pipe.recv()
        except (EOFError, OSError) as error:
            raise self._lost(worker) from error
        if isinstance(answer, YamsimError):
            raise answer
        if isinstance(answer, _Failure):
            raise WorkerBugError(f"in {worker.process.name}, on {worker.job}:\n{answer.trace}")
        assert worker.job is not None
        self._ready.append((worker.job, answer))
        worker.job = None

    def _lost(self, worker: _Worker[J]) -> PartialJobError:
        worker.process.join(_JOIN_SECONDS)
        code = worker.process.exitcode
        how = (
            f"was killed by {signal.Signals(-code).name}"
            if code is not None and code < 0
            else f"ended with code {code}"
        )
        hint = ", perhaps for memory: try fewer --workers" if code == -signal.SIGKILL else ""
        return PartialJobError(f"{worker.process.name} {how} on {worker.job}{hint}")

    def close(self) -> None:
        """End all workers at once, whatever they are doing: none of them has anything to lose."""
        for worker in self._workers:
            worker.pipe.close()
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(_JOIN_SECONDS)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
        self._workers = []

    def __enter__(self) -> WorkerPool[J, R]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@dataclass(frozen=True)
class _Failure:
    trace: str


def _serve(pipe: Connection, factory: Factory[J, R]) -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with factory() as runner:
            while True:
                pipe.send(runner.run(pipe.recv()))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except YamsimError as error:
        _send(pipe, error)
    # Every other exception is a bug; its traceback has to cross to the parent, which stops the job with it.
    except Exception:  # noqa: BLE001
        _send(pipe, _Failure(traceback.format_exc()))


def _send(pipe: Connection, answer: object) -> None:
    try:
        pipe.send(answer)
    except OSError:
        # The parent is gone; nobody is left to tell.
        return
