"""Workers that are processes of this machine.

Each has a pipe of its own, so one that dies takes nothing with it but the job in its hands, and each ends by itself
when the parent is gone. They are spawned, never forked: a fork would share OpenGL.
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

# How long a process may take to end once killed, and a message to arrive once it has begun to.
_END_SECONDS = 5.0
_MESSAGE_SECONDS = 60.0

# Nothing may break off the start of a process half way: neither a stop, nor the alarm by which one that fell into an
# import is raised later.
_HELD = (*STOP_SIGNALS, signal.SIGALRM)


class WorkerPool(Pool[J, R]):
    """An `Executor` over processes of this machine; a context manager that ends them all.

    Args:
        factory: makes each worker's runner, in the worker's process; has to be picklable.
        workers: how many.
        job_seconds: a worker that takes longer over a job is ended and replaced.
    """

    def __init__(self, factory: Factory[J, R], workers: int, job_seconds: float = JOB_SECONDS) -> None:
        super().__init__(_Processes(factory), workers, job_seconds)
        # multiprocessing would ask forgotten workers to end, which they are deaf to, and wait for ever.
        atexit.register(self.close)

    def close(self) -> None:
        """End all workers at once, whatever they are doing: none of them has anything to lose."""
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
        """What the worker has begun to say; None for what another process says, or says of another job."""
        # One that stops in the middle of a message would hold the parent for ever.
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
        # Pickled here: the worker unpickles it once it is on guard.
        self._factory = pickle.dumps(factory)

    def start(self, number: int) -> Worker[J]:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(
            target=serve, args=(theirs, self._factory), name=f"yamsim-worker-{number}", daemon=True
        )
        try:
            with _stop_signals_held():
                process.start()
        except BaseException:
            # A signal that was held is raised here.
            if process.pid is not None:
                process.kill()
            raise
        # Only the worker may hold its end, or the pipe would not close when it dies.
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
def _stop_signals_held() -> Iterator[None]:
    """A process started here is born deaf to Ctrl-C, until it says itself that it ignores it."""
    # Starting the tracker would lift the block; once it runs it is left alone.
    resource_tracker.ensure_running()
    came: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        # A library's thread may take the signal instead, and its handler would run here all the same.
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
