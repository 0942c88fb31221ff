"""Runs commands in forks of a process that has imported yamsim, see `tests.cli.warm_server`."""

from __future__ import annotations

import atexit
import contextlib
import functools
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

REPOSITORY = Path(__file__).parents[2]

# Variables that Python and libraries read at their start: with other values, a fork would differ from a new process.
_READ_AT_START = ("PYTHON", "LD_", "MUJOCO", "PYOPENGL", "OMP_", "OPENBLAS_")


@dataclass
class WarmRun:
    """A command that runs, or has ended."""

    pid: int
    status: int
    code: int | None = None

    def wait(self, timeout: float) -> int:
        """Wait for the exit code. Raise subprocess.TimeoutExpired if the command still runs."""
        if self.code is None:
            if not select.select([self.status], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired("yamsim", timeout)
            self.code = struct.unpack("i", os.read(self.status, 4))[0]
            os.close(self.status)
        return self.code

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, if the command still runs."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End the command, and wait for its end."""
        if self.code is None:
            self.send_signal(signal.SIGKILL)
            self.wait(10)


class WarmProcess:
    """The forked process, from its first use until the end of this process."""

    def __init__(self) -> None:
        self._environ = dict(os.environ)
        self._requests, theirs = socket.socketpair()
        with theirs:
            self._server = subprocess.Popen(
                [sys.executable, "-m", "tests.cli.warm_server", str(theirs.fileno())],
                cwd=REPOSITORY,
                env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
            )
        atexit.register(self._close)

    def suits(self, environ: Mapping[str, str]) -> bool:
        """Whether forks can run in an environment."""
        names = {name for name in {*environ, *self._environ} if name.startswith(_READ_AT_START)} - {"PYTHONPATH"}
        same = all(environ.get(name) == self._environ.get(name) for name in names)
        return same and environ.get("PYTHONPATH") == str(REPOSITORY)

    def start(self, args: Sequence[str], cwd: Path, environ: Mapping[str, str], out: IO[Any], err: IO[Any]) -> WarmRun:
        """Start a command that writes into `out` and `err`."""
        request = json.dumps({"args": list(args), "cwd": str(cwd), "env": dict(environ)}).encode()
        status, theirs = os.pipe()
        try:
            socket.send_fds(self._requests, [request], [out.fileno(), err.fileno(), theirs])
        finally:
            os.close(theirs)
        number = os.read(status, 4)
        assert len(number) == 4, f"the warm process is gone: {self._server.poll()}"
        return WarmRun(struct.unpack("i", number)[0], status)

    def _close(self) -> None:
        self._requests.close()
        self._server.wait(10)


@functools.cache
def warm_process() -> WarmProcess:
    """Return this process's warm process."""
    return WarmProcess()
