"""Runs jobs on workers that may die or hang.

- A worker that dies, or takes too long for a job, is replaced, and the job is tried again.
- A job's last try runs while all other workers are idle, so that their memory use cannot make the job fail.
- A worker that dies before it is ready counts against no job. A worker that fails to start `_MAX_STARTS` times in a row
  is dropped. The pool ends with the last worker.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from ..errors import PartialJobError, YamsimError
from .executors import Executor, J, JobIn, LostJobError, R, WorkerBugError

JOB_TIMEOUT = 600.0  # s, of a job; a longer job means a hung driver or a swapping machine
START_TIMEOUT = 300.0  # s, for imports, compilation of the scene, OpenGL
_MAX_TRIES = 3  # tries of a job whose worker dies, each on another worker
_MAX_STARTS = 3  # failed in a row, after which a worker is dropped
_POLL_SECONDS = 0.5  # between checks of time limits


@dataclass(frozen=True)
class WorkerReady:
    """The worker has created its runner, and takes jobs."""


@dataclass(frozen=True)
class JobFinished(Generic[R]):
    """The worker has finished its job."""

    result: R


@dataclass(frozen=True)
class JobFailed:
    """The runner or its factory raised a `YamsimError`."""

    error: YamsimError


@dataclass(frozen=True)
class WorkerCrashed:
    """The runner or its factory raised another exception; `trace` is its traceback."""

    trace: str


@dataclass(frozen=True)
class WorkerDied:
    """The worker has ended; `cause` completes a sentence that begins with "its worker"."""

    cause: str


WorkerEvent = WorkerReady | JobFinished[R] | JobFailed | WorkerCrashed | WorkerDied


class Worker(Protocol[JobIn]):
    """One worker of a pool."""

    @property
    def name(self) -> str:
        """Name of the worker in messages."""

    def send(self, job: JobIn) -> None:
        """Give the worker a job. Raises OSError if the worker has ended."""

    def kill(self) -> None:
        """End the worker immediately, and wait for its end."""


W = TypeVar("W")


class WorkerBackend(Protocol[W, R]):
    """Starts workers of one kind, such as processes, and receives their events."""

    def start(self, number: int) -> W:
        """Start a worker, and return before the worker is ready."""

    def wait(self, workers: Sequence[W], timeout: float) -> Sequence[tuple[W, WorkerEvent[R]]]:
        """Return events of workers, at most one for each; empty if none arrives within `timeout` seconds."""

    def close(self) -> None:
        """Free the resources that all workers share."""


@dataclass(eq=False)
class _Task(Generic[J]):
    job: J
    lost_workers: int = 0

    @property
    def is_last_try(self) -> bool:
        return self.lost_workers == _MAX_TRIES - 1


@dataclass(eq=False)
class _Slot(Generic[J]):
    worker: Worker[J]
    task: _Task[J] | None = None
    ready: bool = False
    failed_starts: int = 0
    busy_seconds: float = 0.0  # s, spent so far on the start or on the task


class BaseWorkerPool(Executor[J, R]):
    """Base of executors for any kind of worker, which replaces workers that die, hang, or exceed `job_seconds`."""

    def __init__(self, backend: WorkerBackend[Worker[J], R], workers: int, job_seconds: float = JOB_TIMEOUT) -> None:
        self._backend = backend
        self._job_seconds = job_seconds
        self._slots: list[_Slot[J]] = []
        self._waiting: deque[_Task[J]] = deque()
        self._done: deque[tuple[J, R] | Exception] = deque()
        self._started = 0
        try:
            for _ in range(workers):
                self._slots.append(_Slot(self._start_worker()))
        except BaseException:
            self.close()
            raise

    @property
    def idle(self) -> int:
        """Number of jobs that can be submitted now; 0 before and during a job's last try."""
        tasks = [*self._waiting, *(slot.task for slot in self._slots if slot.task)]
        if any(task.is_last_try for task in tasks):
            return 0
        return max(0, len(self._slots) - len(tasks))

    @property
    def in_flight(self) -> int:
        """See `Executor.in_flight`."""
        return self._busy_workers + len(self._waiting) + len(self._done)

    @property
    def _busy_workers(self) -> int:
        return sum(slot.task is not None for slot in self._slots)

    def submit(self, job: J) -> None:
        """See `Executor.submit`."""
        assert self.idle
        self._waiting.append(_Task(job))
        self._assign_jobs()

    def next_result(self, timeout: float | None = None) -> tuple[J, R]:
        """See `Executor.next_result`."""
        end = math.inf if timeout is None else time.monotonic() + timeout
        while not self._done:
            assert self.in_flight, "nothing was submitted"
            left = end - time.monotonic()
            if left <= 0:
                raise TimeoutError
            self._receive_events(min(_POLL_SECONDS, left))
        done = self._done.popleft()
        if isinstance(done, Exception):
            raise done
        return done

    def _receive_events(self, timeout: float) -> None:
        began = time.monotonic()
        events = self._backend.wait([slot.worker for slot in self._slots], timeout)
        # While the machine or this process slept, the workers slept too: count at most `timeout`.
        passed = min(time.monotonic() - began, timeout)
        heard = []
        for worker, event in events:
            slot = next(slot for slot in self._slots if slot.worker is worker)
            heard.append(slot)
            self._handle_event(slot, event)
        for slot in [slot for slot in self._slots if slot not in heard]:
            if slot.task or not slot.ready:
                slot.busy_seconds += passed
                self._check_timeout(slot)
        self._assign_jobs()

    def _handle_event(self, slot: _Slot[J], event: WorkerEvent[R]) -> None:
        match event:
            case WorkerReady():
                slot.ready, slot.busy_seconds, slot.failed_starts = True, 0.0, 0
            case JobFinished(result):
                assert slot.task is not None
                self._done.append((slot.task.job, result))
                slot.task, slot.busy_seconds = None, 0.0
            case JobFailed(error):
                slot.task = None
                self._done.append(error)
            case WorkerCrashed(trace):
                on = f", on {slot.task.job}" if slot.task else ""
                slot.task = None
                self._done.append(WorkerBugError(f"in {slot.worker.name}{on}:\n{trace}"))
            case WorkerDied(how):
                self._replace_worker(slot, how)

    def _check_timeout(self, slot: _Slot[J]) -> None:
        limit = self._job_seconds if slot.ready else START_TIMEOUT
        if slot.busy_seconds > limit:
            slot.worker.kill()
            self._replace_worker(slot, f"was ended after {limit:g} s without a result")

    def _replace_worker(self, slot: _Slot[J], how: str) -> None:
        task, slot.task = slot.task, None
        if task:
            task.lost_workers += 1
        if task and task.lost_workers >= _MAX_TRIES:
            self._done.append(LostJobError(task.job, _MAX_TRIES, how))
        elif task:
            self._waiting.appendleft(task)
        slot.failed_starts += not slot.ready
        if slot.failed_starts < _MAX_STARTS:
            slot.worker, slot.ready, slot.busy_seconds = self._start_worker(), False, 0.0
            return
        self._slots.remove(slot)
        if not self._slots:
            raise PartialJobError(f"workers do not start: each failed {_MAX_STARTS} times, and the last one {how}")

    def _assign_jobs(self) -> None:
        """Give waiting jobs to ready workers; a last try only while no other worker is busy."""
        for slot in self._slots:
            if not self._waiting or (self._waiting[0].is_last_try and self._busy_workers):
                return
            if slot.ready and slot.task is None:
                slot.task, slot.busy_seconds = self._waiting.popleft(), 0.0
                try:
                    slot.worker.send(slot.task.job)
                except OSError:
                    # The worker died while idle; its `WorkerDied` event follows. The job loses no try.
                    self._waiting.appendleft(slot.task)
                    slot.task = None

    def _start_worker(self) -> Worker[J]:
        self._started += 1
        return self._backend.start(self._started - 1)

    def close(self) -> None:
        """See `Executor.close`."""
        for slot in self._slots:
            slot.worker.kill()
        self._slots = []
        self._backend.close()
