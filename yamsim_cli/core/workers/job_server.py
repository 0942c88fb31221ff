"""What runs in a worker's process: a `JobServer` makes a runner, and then answers job by job.

This module imports little, so that a new process soon ignores stop signals and watches its parent.
"""

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
from .executors import Factory, JobRunner
from .worker_pool import Event, JobFailed, JobFinished, WorkerCrashed, WorkerReady

# Signals that stop the parent. They reach all processes of the parent's group, and the parent alone acts on them.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

# Stands before every answer: the id of the answering process, and the number of the job, or 0 for "ready".
HEADER = struct.Struct("!QQ")


class JobServer:
    """Runs jobs. A servant never raises: an error is an answer, too. Answers are pickled `pool.Event`s."""

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._runner: JobRunner[Any, Any] | None = None

    @property
    def is_ready(self) -> bool:
        """Whether the runner could be made."""
        return self._runner is not None

    def open(self, factory: bytes) -> bytes:
        """The answer to making the runner.

        Args:
            factory: a pickled `executor.Factory`; unpickling imports what the runner needs, which takes seconds.
        """

        def make() -> Event[Any]:
            opened: Factory[Any, Any] = pickle.loads(factory)
            self._runner = self._stack.enter_context(opened())
            return WorkerReady()

        return _answer(make)

    def run(self, job: Any) -> bytes:
        """The answer to one job."""
        runner = self._runner
        assert runner is not None, "open comes first"
        return _answer(lambda: JobFinished(runner.run(job)))

    def close(self) -> None:
        """Close the runner."""
        self._stack.close()


def serve_jobs(pipe: Connection, factory: bytes) -> None:
    """Answer jobs from a pipe until the pipe closes.

    Args:
        pipe: brings numbered jobs, and takes pickled `pool.Event`s, each behind a `HEADER`.
        factory: see `JobServer.open`.
    """
    # EOFError or OSError mean that the parent closed the pipe, or is gone.
    with contextlib.closing(JobServer()) as servant, contextlib.suppress(EOFError, OSError):
        pipe.send_bytes(HEADER.pack(os.getpid(), 0) + servant.open(factory))
        while servant.is_ready:
            number, job = pipe.recv()
            pipe.send_bytes(HEADER.pack(os.getpid(), number) + servant.run(job))


def end_with_parent() -> None:
    """End this process as soon as its parent has ended, even in the middle of a job: MuJoCo releases the GIL."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _answer(work: Callable[[], Event[Any]]) -> bytes:
    try:
        with kill_forks_at_exit():
            return pickle.dumps(work(), pickle.HIGHEST_PROTOCOL)
    except YamsimError as error:
        return pickle.dumps(JobFailed(error))
    # Every other exception is a bug. Its traceback goes to the parent, which stops with it.
    except Exception:  # noqa: BLE001
        return pickle.dumps(WorkerCrashed(traceback.format_exc()))


@contextlib.contextmanager
def kill_forks_at_exit() -> Iterator[None]:
    """End every process that user code forked in the `with` block, at the end of the block.

    A fork that returns from a policy would otherwise go on as a second copy of the worker, and answer twice. A fork
    that exits by itself keeps its exit code.
    """
    own = os.getpid()
    try:
        yield
    except SystemExit as end:
        if os.getpid() != own:
            # The code that `sys.exit` makes of its argument.
            os._exit(0 if end.code is None else end.code if isinstance(end.code, int) else 1)
        raise
    finally:
        if os.getpid() != own:
            os._exit(1)
