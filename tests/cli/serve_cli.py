"""Run a command that shows something until a signal ends it, as a user does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).parents[2]


@dataclass(frozen=True)
class Shown:
    """A command that runs.

    Attributes:
        report: what it printed once it was ready.
    """

    process: subprocess.Popen[str]
    report: dict[str, Any]

    @property
    def url(self) -> str:
        return str(self.report["url"])

    def end(self, number: signal.Signals = signal.SIGINT) -> tuple[int, str, list[str]]:
        """Exit code, what it still printed, and its complaints; that meshes are missing is none."""
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=30)
        return self.process.returncode, out, [line for line in err.splitlines() if not line.startswith("The meshes of")]


@contextmanager
def shown(*args: str | Path, **env: str) -> Iterator[Shown]:
    """`yamsim ARGS --json` in a process of its own, from when it tells where it is to be seen."""
    process = subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", *map(str, args), "--json"],
        cwd=REPOSITORY,
        env={**os.environ, **env},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        said = ""
        while not said.endswith("}\n"):
            line = process.stdout.readline()
            assert line, process.stderr and process.stderr.read()
            said += line
        yield Shown(process, json.loads(said))
    finally:
        process.kill()
        process.communicate()
