"""A process that works beside this one for as long as it lasts, and is talked to through a pipe of its own."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from .processes import stop_signals_held
from .serving import STOP_SIGNALS, end_with_parent


def start_beside(name: str, work: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Start a process that calls `work(pipe, *arguments)`, and our end of the pipe.

    It is spawned, ignores stop signals, and ends with this process. What it is given has to be picklable.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_run, args=(work, theirs, arguments), name=name, daemon=True)
    with stop_signals_held():
        process.start()
    # Only the process may hold this end, or the pipe would not close when it dies.
    theirs.close()
    return process, ours


def _run(work: Callable[..., None], pipe: Connection, arguments: tuple[Any, ...]) -> None:
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()
    work(pipe, *arguments)
