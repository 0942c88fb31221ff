"""Workers as processes of this machine, each with its own pipe, so that a process that dies loses only its job.

Processes are spawned and never forked: a fork would share OpenGL.
"""

from __future__ import annotations

import atexit
import multiprocessing
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, cast

from .executors import J, OpenRunner, R
from .job_server import ANSWER_HEADER, STOP_SIGNALS, end_with_parent, serve_jobs
from .worker_pool import JOB_TIMEOUT, BaseWorkerPool, Worker, WorkerDied, WorkerEvent

_KILL_TIMEOUT = 5.0  # s, timeout for the end of a killed process
MESSAGE_TIMEOUT = 60.0  # s, timeout from the first byte of a message to the last

# Blocked while a process starts. `__main__` uses SIGALRM to delay a stop that arrives during an import.
_BLOCKED_SIGNALS = (*STOP_SIGNALS, signal.SIGALRM)


Starter = Callable[..., tuple[BaseProcess, Connection]]


class ProcessPool(BaseWorkerPool[J, R]):
    """An `Executor` that runs jobs in processes of this machine, which `start` starts, by default `start_process`.

    `factory` creates the runner in each process.
    """

    def __init__(
        self, factory: OpenRunner[J, R], workers: int, job_seconds: float = JOB_TIMEOUT, start: Starter | None = None
    ) -> None:
        super().__init__(_Processes(factory, start or start_process), workers, job_seconds)
        # At exit, multiprocessing would send SIGTERM to remaining workers, which ignore it, and wait forever.
        atexit.register(self.close)

    def close(self) -> None:
        """End all processes immediately, even during a job."""
        super().close()
        atexit.unregister(self.close)


class _Process(Generic[J, R]):
    def __init__(self, process: BaseProcess, pipe: Connection) -> None:
        self._process = process
        self.pipe = pipe
        self._sent = 0

    @property
    def name(self) -> str:
        return self._process.name

    def send(self, job: J) -> None:
        self._sent += 1
        self.pipe.send((self._sent, job))

    def receive(self) -> WorkerEvent[R] | None:
        """Return the event that is arriving; None if it is from a forked copy of the worker, or for an earlier job."""
        # A worker that stops during a message would block the parent forever.
        guard = threading.Timer(MESSAGE_TIMEOUT, self._process.kill)
        guard.daemon = True
        guard.start()
        try:
            message = memoryview(self.pipe.recv_bytes())
            if ANSWER_HEADER.unpack_from(message) != (self._process.pid, self._sent):
                return None
            return cast("WorkerEvent[R]", pickle.loads(message[ANSWER_HEADER.size :]))
        except (EOFError, OSError):
            return WorkerDied(self._exit_description())
        finally:
            guard.cancel()

    def kill(self) -> None:
        self.pipe.close()
        self._process.kill()
        self._process.join(_KILL_TIMEOUT)

    def _exit_description(self) -> str:
        self._process.join(_KILL_TIMEOUT)
        code = self._process.exitcode
        if code is None or code >= 0:
            return f"ended with code {code}"
        hint = ", perhaps because memory ran out: try fewer --workers" if code == -signal.SIGKILL else ""
        return f"was killed by {signal.Signals(-code).name}{hint}"


class _Processes(Generic[J, R]):
    def __init__(self, factory: OpenRunner[J, R], start: Starter) -> None:
        # The worker unpickles the factory itself, after its signal setup.
        self._factory, self._start_process = pickle.dumps(factory), start

    def start(self, number: int) -> Worker[J]:
        return _Process[J, R](*self._start_process(f"yamsim-worker-{number}", serve_jobs, self._factory))

    def wait(self, workers: Sequence[Worker[J]], timeout: float) -> list[tuple[Worker[J], WorkerEvent[R]]]:
        processes = {worker.pipe: worker for worker in workers if isinstance(worker, _Process)}
        ready = cast("list[Any]", wait(list(processes), timeout))
        heard = [(processes[pipe], processes[pipe].receive()) for pipe in ready]
        return [(worker, event) for worker, event in heard if event is not None]

    def close(self) -> None:
        return


@contextmanager
def stop_signals_blocked() -> Iterator[None]:
    """Delay stop signals until the end of the `with` block. Processes that start in it inherit blocked signals."""
    # The start of multiprocessing's resource tracker unblocks signals, so the tracker is started first.
    resource_tracker.ensure_running()
    came: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        # A thread of a library may receive the signal, and Python would then run the handler in this main thread.
        for number in _BLOCKED_SIGNALS:
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, lambda number, frame: came.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _BLOCKED_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for one in dict.fromkeys(came):
            signal.raise_signal(one)


def start_process(name: str, work: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Start a process that calls `work(pipe, *arguments)`, and return the process and this end of the pipe.

    The process is spawned, ignores stop signals, and ends with this process. `work` and `arguments` are picklable.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_run_worker_process, args=(work, theirs, arguments), name=name, daemon=True)
    try:
        with stop_signals_blocked():
            process.start()
    except BaseException:
        # `stop_signals_blocked` raises a blocked signal at its end.
        if process.pid is not None:
            process.kill()
        raise
    # Only the new process may hold the other end. Otherwise the pipe would not close when the process dies.
    theirs.close()
    return process, ours


def _run_worker_process(work: Callable[..., None], pipe: Connection, arguments: tuple[Any, ...]) -> None:
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()
    work(pipe, *arguments)
