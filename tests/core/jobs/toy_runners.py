"""Runners that have nothing to do with robots, in a module of their own for spawned processes to find."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import struct
import time
from multiprocessing.connection import Connection
from pathlib import Path

from yamsim_cli.core.errors import ResourceError, SimulationError


class Toy:
    """Answers a job, a small number or a word, in the way the word says.

    Args:
        start: "refuse" raises in making the runner, "die" ends the process there.
    """

    def __init__(self, start: str = "") -> None:
        self._start = start

    def __enter__(self) -> Toy:
        if self._start == "refuse":
            raise ResourceError("no toys here")
        if self._start == "die":
            os._exit(9)
        return self

    def __exit__(self, *reason: object) -> None:
        return

    def run(self, job: int | str) -> object:
        if isinstance(job, int):
            # The first are the slowest, so that answers come out of order.
            time.sleep(0.05 if job < 2 else 0.0)
            return job * job
        word, _, argument = job.partition(":")
        match word:
            case "error":
                raise SimulationError("the toy is broken")
            case "bug":
                raise ZeroDivisionError("nobody expected this")
            case "pid":
                return os.getpid()
            case "sleep":
                time.sleep(60)
            case "variable":
                return os.environ[argument]
            case "lambda":
                return lambda: "not to be pickled"
            case "large":
                return bytes(int(argument))
            case "once":
                return _once(Path(argument), job)
        return _die(word)


def _once(flag: Path, job: str) -> str:
    """Die the first time."""
    if not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return f"{job} again"


def _die(how: str) -> None:
    match how:
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "segfault":
            ctypes.string_at(0)
        case "exit":
            os._exit(7)
        case "freeze":
            os.kill(os.getpid(), signal.SIGSTOP)
        case "half":
            # Begins an answer of a thousand bytes and never ends it.
            pipe = next(o for o in gc.get_objects() if isinstance(o, Connection) and o.readable and o.writable)
            os.write(pipe.fileno(), struct.pack("!i", 1000) + b"x")
            time.sleep(60)
