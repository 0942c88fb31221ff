"""Starts the first worker of a recording early: it imports its modules while the command reads its configs."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from .core.closable import Closable
from .core.workers.process_pool import start_process
from .gl import bind_backend

# Modules that every attempt needs. Their imports take 1 s of a core, most of the start of a worker.
_MODULES = ("mink", "yamsim_cli.core.episode.runner")


class EarlyWorker(Closable):
    """A worker process that starts before its session is known.

    Its `start` starts the processes of a `ProcessPool`: the first call returns the process that runs already, and the
    pool then ends it. `close` ends a process that no pool has taken.
    """

    def __init__(self) -> None:
        self._started: tuple[BaseProcess, Connection] | None = start_process("yamsim-worker-0", _serve_early)

    def start(self, name: str, work: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
        """Start a process as `start_process` does. The early process gets the present environment variables."""
        if self._started is None:
            return start_process(name, work, *arguments)
        (process, pipe), self._started = self._started, None
        # The pool notices that a process has ended, and starts another one.
        with contextlib.suppress(OSError):
            pipe.send((dict(os.environ), work, arguments))
        return process, pipe

    def close(self) -> None:
        """End the process unless a pool has taken it."""
        if self._started is not None:
            (process, pipe), self._started = self._started, None
            pipe.close()
            process.kill()
            process.join()


def _serve_early(pipe: Connection) -> None:
    # MuJoCo loads OpenGL when it is imported. On Linux, the backend is known only later, unless the user has set it.
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "off")
    # The runner imports the same modules, and reports errors.
    with contextlib.suppress(Exception):
        for name in _MODULES:
            importlib.import_module(name)
    # The pipe is closed if no pool takes the process.
    with contextlib.suppress(EOFError, OSError):
        environ, work, arguments = pipe.recv()
        os.environ.update(environ)
        bind_backend(environ.get("MUJOCO_GL", ""))
        work(pipe, *arguments)
