"""Run a command that runs until a signal, as a user does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from tests.cli.warm import REPOSITORY, WarmRun, warm_process


@dataclass(frozen=True)
class RunningCommand:
    """A running command. `report` is its output once it was ready."""

    run: WarmRun | subprocess.Popen[bytes]
    out: IO[str]
    err: IO[str]
    report: dict[str, Any]

    @property
    def url(self) -> str:
        return str(self.report["url"])

    def still_runs(self) -> bool:
        """Whether it has not ended by itself."""
        try:
            self.run.wait(0)
        except subprocess.TimeoutExpired:
            return True
        return False

    def end(self, number: signal.Signals = signal.SIGINT) -> tuple[int, str, list[str]]:
        """Return exit code, further output, and complaints other than missing meshes."""
        self.run.send_signal(number)
        code = self.run.wait(30)
        lines = complaints(self.err)
        return code, self.out.read(), lines


def complaints(err: IO[str]) -> list[str]:
    """Return the lines of stderr without notes on missing meshes."""
    err.seek(0)
    return [line for line in err.read().splitlines() if not line.startswith("The meshes of")]


@contextmanager
def shown(*args: str | Path, **env: str) -> Iterator[RunningCommand]:
    """Run `yamsim ARGS --json` in a process, from the report of its address on.

    With an environment of its own, for another display, a new Python process is started.
    """
    read, write = os.pipe()
    with os.fdopen(read) as out, tempfile.TemporaryFile("w+") as err:
        with os.fdopen(write) as theirs:
            run = _start([*map(str, args), "--json"], env, theirs, err)
        try:
            said = ""
            while not said.endswith("}\n"):
                line = out.readline()
                assert line, complaints(err)
                said += line
            yield RunningCommand(run, out, err, json.loads(said))
        finally:
            run.kill()
            run.wait(10)


def _start(args: list[str], env: dict[str, str], out: IO[str], err: IO[str]) -> WarmRun | subprocess.Popen[bytes]:
    environ = {**os.environ, "PYTHONPATH": str(REPOSITORY), **env}
    if not env and warm_process().suits(environ):
        return warm_process().start(args, REPOSITORY, environ, out, err)
    command = [sys.executable, "-m", "yamsim_cli", *args]
    return subprocess.Popen(command, cwd=REPOSITORY, env=environ, stdin=subprocess.DEVNULL, stdout=out, stderr=err)
