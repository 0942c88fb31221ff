"""The server in a worker's process. It has few imports, so that it ignores stop signals early."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import struct
import traceback
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

from ..errors import YamsimError
from .executors import OpenRunner, SingleJobRunner
from .worker_pool import JobFailed, JobFinished, WorkerCrashed, WorkerEvent, WorkerReady

# All processes of the parent's group receive these signals, but only the parent reacts.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

# Header of an answer: the id of the answering process, and the number of the job, or 0 for "ready".
ANSWER_HEADER = struct.Struct("!QQ")


class WorkerJobRunner:
    """Creates a runner, and then runs one job after the other.

    `create_runner` and `run` return a pickled `WorkerEvent`, which also reports errors, and never raise.
    """

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._runner: SingleJobRunner[Any, Any] | None = None

    @property
    def is_ready(self) -> bool:
        """Whether the runner exists."""
        return self._runner is not None

    def create_runner(self, factory: bytes) -> bytes:
        """Create the runner from a pickled `OpenRunner`, and return a pickled event: `WorkerReady` or an error.

        Unpickling imports the runner's modules, which takes seconds.
        """

        def make() -> WorkerEvent[Any]:
            opened: OpenRunner[Any, Any] = pickle.loads(factory)
            self._runner = self._stack.enter_context(opened())
            return WorkerReady()

        return _run_to_event(make)

    def run(self, job: Any) -> bytes:
        """Run one job, and return a pickled event: `JobFinished` with the result, or an error."""
        runner = self._runner
        assert runner is not None, "call create_runner first"
        return _run_to_event(lambda: JobFinished(runner.run(job)))

    def close(self) -> None:
        """Close the runner."""
        self._stack.close()


def serve_jobs(pipe: Connection, factory: bytes) -> None:
    """Answer jobs from a pipe until it closes.

    The pipe delivers numbered jobs, and takes pickled `WorkerEvent`s, each after an `ANSWER_HEADER`.
    """
    # The parent closed the pipe, or has ended.
    with contextlib.closing(WorkerJobRunner()) as server, contextlib.suppress(EOFError, OSError):
        pipe.send_bytes(ANSWER_HEADER.pack(os.getpid(), 0) + server.create_runner(factory))
        while server.is_ready:
            number, job = pipe.recv()
            pipe.send_bytes(ANSWER_HEADER.pack(os.getpid(), number) + server.run(job))


def end_with_parent() -> None:
    """End this process as soon as its parent has ended, even during a job: MuJoCo releases the GIL."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _run_to_event(work: Callable[[], WorkerEvent[Any]]) -> bytes:
    try:
        with kill_forks_at_exit():
            return pickle.dumps(work(), pickle.HIGHEST_PROTOCOL)
    except YamsimError as error:
        return pickle.dumps(JobFailed(error))
    # Every other exception is a bug. The parent gets the traceback, and raises a `WorkerBugError` with it.
    except Exception:  # noqa: BLE001
        return pickle.dumps(WorkerCrashed(traceback.format_exc()))


@contextlib.contextmanager
def kill_forks_at_exit() -> Iterator[None]:
    """End, at the end of the `with` block, every process that user code forked in the block.

    A forked process that returns from user code, such as a policy, would otherwise continue as a second copy of the
    worker, and answer twice. A forked process that exits by itself keeps its exit code.
    """
    own = os.getpid()
    try:
        yield
    except SystemExit as end:
        if os.getpid() != own:
            # The exit code that `sys.exit` derives from its argument.
            os._exit(0 if end.code is None else end.code if isinstance(end.code, int) else 1)
        raise
    finally:
        if os.getpid() != own:
            os._exit(1)
