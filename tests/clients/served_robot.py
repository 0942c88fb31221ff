"""`yamsim serve-robot` in a process, and a client's Python on its buses."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.clients.environments import REPOSITORY, SCRIPTS, Interpreter

_ENVIRON = {**os.environ, "PYTHONPATH": str(REPOSITORY)}


@dataclass
class ServedRobot:
    """A running server.

    Attributes:
        folder: of its buses.
        process: process ID.
        ports: of portal.
        chiral: port of chiral; 0 without.
        report: its output at its end; filled by then.
    """

    folder: Path
    process: int
    ports: list[int] = field(default_factory=list)
    chiral: int = 0
    report: dict[str, Any] = field(default_factory=dict)

    def call(self, client: Interpreter, *arguments: object, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
        """Run a client's Python by `yamsim can-run`."""
        words = ["can-run", "--folder", str(self.folder), "--", str(client.python), *map(str, arguments)]
        return subprocess.run(
            [sys.executable, "-m", "yamsim_cli", *words],
            env=_ENVIRON,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def run(self, client: Interpreter, script: str, *arguments: object, timeout_s: float = 120) -> dict[str, Any]:
        """Return the JSON in the last line of a script of `scripts/`."""
        done = self.call(client, SCRIPTS / script, *arguments, timeout_s=timeout_s)
        assert done.returncode == 0, done.stdout + done.stderr
        answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return answer


@contextmanager
def served_robot(folder: Path, *flags: str) -> Iterator[ServedRobot]:
    """Run `yamsim serve-robot` with flags, from the existence of its buses on."""
    command = [sys.executable, "-m", "yamsim_cli", "serve-robot", "--folder", str(folder), "--json", *flags]
    with subprocess.Popen(command, env=_ENVIRON, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        served = ServedRobot(folder, process.pid)
        assert process.stderr and process.stdout
        for line in process.stderr:
            if found := re.match(r"127\.0\.0\.1:(\d+): calls", line):
                served.ports.append(int(found[1]))
            if found := re.match(r"127\.0\.0\.1:(\d+): chiral", line):
                served.chiral = int(found[1])
            if "Ctrl-C ends" in line:
                break
        try:
            yield served
        finally:
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=20)
            assert process.returncode == 0, err
            served.report = json.loads(out)
