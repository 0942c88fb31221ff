"""Runners that have nothing to do with robots, in a module of their own for spawned processes to find."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from yamsim_cli.core.errors import SimulationError


class Toy:
    """Answers a job, a small number or a word, in the way the word says."""

    def __init__(self, log: Path | None = None) -> None:
        self._log = log

    def __enter__(self) -> Toy:
        return self

    def __exit__(self, *reason: object) -> None:
        if self._log:
            self._log.write_text("closed")

    def run(self, job: int | str) -> object:
        match job:
            case "error":
                raise SimulationError("the toy is broken")
            case "bug":
                raise ZeroDivisionError("nobody expected this")
            case "die":
                os.kill(os.getpid(), signal.SIGKILL)
            case "exit":
                os._exit(7)
            case "pid":
                return os.getpid()
            case "sleep":
                time.sleep(60)
            case int():
                # The first are the slowest, so that answers come out of order.
                time.sleep(0.05 if job < 2 else 0.0)
                return job * job
        return None
