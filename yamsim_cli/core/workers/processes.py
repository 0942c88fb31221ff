"""Workers that are processes of this machine.

Each has a pipe of its own, so that one that dies costs only the job that it runs. Each ends by itself when the parent
is gone. They are spawned and never forked: a fork would share OpenGL.
"""

from __future__ import annotations

import atexit
import multiprocessing
import pickle
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, cast

from .executor import Factory, J, R
from .pool import JOB_SECONDS, Died, Event, Pool, Worker
from .serving import HEADER, STOP_SIGNALS, serve

# How long a process may take to end after it was killed, s.
_END_SECONDS = 5.0
# How long a message may take to arrive after its beginning has, s.
_MESSAGE_SECONDS = 60.0

# Signals that are held back while a process starts, which must not be interrupted. The alarm is among them, because a
# stop that comes during an import is raised by it later.
_HELD = (*STOP_SIGNALS, signal.SIGALRM)


class WorkerPool(Pool[J, R]):
    """An `Executor` over processes of this machine; a context manager that ends them all.

    Args:
        factory: makes each worker's runner, in the worker's process; it has to be picklable.
        workers: how many workers there are.
        job_seconds: a worker that takes longer for a job is ended and replaced.
    """

    def __init__(self, factory: Factory[J, R], workers: int, job_seconds: float = JOB_SECONDS) -> None:
        super().__init__(_Processes(factory), workers, job_seconds)
        # At exit multiprocessing would ask forgotten workers to end, which they ignore, and wait for ever.
        atexit.register(self.close)

    def close(self) -> None:
        """End all workers at once, whatever they are doing: none of them holds anything that could be lost."""
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

    def receive(self) -> Event[R] | None:
        """The event that the worker has begun to send; None if another process sent it, or it is on another job."""
        # A worker that stops in the middle of a message would hold the parent for ever.
        guard = threading.Timer(_MESSAGE_SECONDS, self._process.kill)
        guard.daemon = True
        guard.start()
        try:
            message = memoryview(self.pipe.recv_bytes())
            if HEADER.unpack_from(message) != (self._process.pid, self._sent):
                return None
            return cast("Event[R]", pickle.loads(message[HEADER.size :]))
        except (EOFError, OSError):
            return Died(self._how_it_ended())
        finally:
            guard.cancel()

    def kill(self) -> None:
        self.pipe.close()
        self._process.kill()
        self._process.join(_END_SECONDS)

    def _how_it_ended(self) -> str:
        self._process.join(_END_SECONDS)
        code = self._process.exitcode
        if code is None or code >= 0:
            return f"ended with code {code}"
        hint = ", perhaps for want of memory: try fewer --workers" if code == -signal.SIGKILL else ""
        return f"was killed by {signal.Signals(-code).name}{hint}"


class _Processes(Generic[J, R]):
    """The `Backend` that spawns processes."""

    def __init__(self, factory: Factory[J, R]) -> None:
        self._context = multiprocessing.get_context("spawn")
        # Pickled here, so that the worker can unpickle it after it has set up its signals.
        self._factory = pickle.dumps(factory)

    def start(self, number: int) -> Worker[J]:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(
            target=serve, args=(theirs, self._factory), name=f"yamsim-worker-{number}", daemon=True
        )
        try:
            with stop_signals_held():
                process.start()
        except BaseException:
            # A signal that was held back is raised here.
            if process.pid is not None:
                process.kill()
            raise
        # Only the worker may hold this end, or the pipe would not close when it dies.
        theirs.close()
        return _Process[J, R](process, ours)

    def wait(self, workers: Sequence[Worker[J]], timeout: float) -> list[tuple[Worker[J], Event[R]]]:
        processes = {worker.pipe: worker for worker in workers if isinstance(worker, _Process)}
        ready = cast("list[Any]", wait(list(processes), timeout))
        heard = [(processes[pipe], processes[pipe].receive()) for pipe in ready]
        return [(worker, event) for worker, event in heard if event is not None]

    def close(self) -> None:
        return


@contextmanager
def stop_signals_held() -> Iterator[None]:
    """Hold back stop signals in the block. A process that starts in it begins with them blocked."""
    # Starting multiprocessing's resource tracker would lift the block, so that it is started before.
    resource_tracker.ensure_running()
    came: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        # A library's thread may receive the signal, and its handler would run in this thread all the same.
        for number in _HELD:
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, lambda number, frame: came.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _HELD)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for one in dict.fromkeys(came):
            signal.raise_signal(one)
