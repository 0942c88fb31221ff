"""A worker's own process: makes its runner, then answers job by job. Imports little, to be on guard early."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from multiprocessing.connection import Connection
from typing import Any

from ..errors import YamsimError
from .executor import Factory, J, R, Runner
from .pool import Answer, Bug, Event, Failed, Ready

# What stops the parent. It reaches the whole process group or job, and the parent alone decides what it means.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def serve(pipe: Connection, factory: bytes) -> None:
    """Answer what comes through the pipe until it closes.

    Args:
        pipe: jobs come in, `pool.Event`s go out.
        factory: a pickled `executor.Factory`; unpickling it imports what the runner needs, which takes a while.
    """
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        make: Factory[Any, Any] = pickle.loads(factory)
        with make() as runner:
            _send(pipe, Ready())
            while True:
                _send(pipe, answer(runner, _receive(pipe)))
    except YamsimError as error:
        _send(pipe, Failed(error))
    # Every other exception is a bug; its traceback has to cross to the parent, which stops with it.
    except Exception:  # noqa: BLE001
        _send(pipe, Bug(traceback.format_exc()))


def answer(runner: Runner[J, R], job: J) -> Event[R]:
    """Run one job; an error of the job is an answer too."""
    try:
        return Answer(runner.run(job))
    except YamsimError as error:
        return Failed(error)


def _end_with_parent() -> None:
    """End this process as soon as its parent has ended, also in the middle of a job: MuJoCo works without the GIL."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _receive(pipe: Connection) -> Any:
    try:
        return pipe.recv()
    except (EOFError, OSError):
        raise SystemExit from None


def _send(pipe: Connection, event: Event[Any]) -> None:
    try:
        pipe.send(event)
    except OSError:
        # The parent closed the pipe or is gone: nobody is left to tell.
        raise SystemExit from None
