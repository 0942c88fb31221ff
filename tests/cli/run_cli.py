"""Run the executable as a user does, in a new process or a fork of a warm one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.cli.warm import REPOSITORY, warm_process


@dataclass(frozen=True)
class Run:
    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        data: dict[str, Any] = json.loads(self.out)
        return data

    @property
    def message(self) -> str:
        """The single line of an error on stderr."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        assert lines[0].startswith("yamsim: ")
        return lines[0].removeprefix("yamsim: ")


def yamsim(
    *args: str | Path,
    cwd: Path = REPOSITORY,
    env: Mapping[str, str] | None = None,
    timeout: float = 300,
    fresh: bool = False,
) -> Run:
    """Run `yamsim ARGS`, and return its output and exit code.

    Args:
        fresh: whether to start a new Python process. By default, a process that has imported yamsim is forked.
    """
    words = [str(arg) for arg in args]
    environ = {**os.environ, "PYTHONPATH": str(REPOSITORY), **(env or {})}
    if not fresh and warm_process().suits(environ):
        return _run_warm(words, cwd, environ, timeout)
    done = subprocess.run(
        [sys.executable, "-m", "yamsim_cli", *words],
        cwd=cwd,
        env=environ,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    return Run(done.returncode, done.stdout, done.stderr)


def _run_warm(words: Sequence[str], cwd: Path, environ: Mapping[str, str], timeout: float) -> Run:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        run = warm_process().start(words, cwd, environ, out, err)
        try:
            code = run.wait(timeout)
        finally:
            run.kill()
        for stream in (out, err):
            stream.seek(0)
        return Run(code, out.read().decode(), err.read().decode())
