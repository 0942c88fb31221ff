"""Runners without robots, in a module that spawned processes can import."""

from __future__ import annotations

import ctypes
import gc
import os
import pickle
import signal
import struct
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

from yamsim_cli.core.errors import ResourceError, SimulationError
from yamsim_cli.core.workers.job_server import ANSWER_HEADER
from yamsim_cli.core.workers.worker_pool import JobFinished


class ToyRunner:
    """Answers a job, a small number or a word, as the word demands.

    Args:
        start: "refuse" raises when the runner is made, "die" ends the process there.
    """

    def __init__(self, start: str = "") -> None:
        self._start = start

    def __enter__(self) -> ToyRunner:
        if self._start == "refuse":
            raise ResourceError("no toys here")
        if self._start == "die":
            os._exit(9)
        return self

    def __exit__(self, *reason: object) -> None:
        return

    def run(self, job: int | str) -> object:
        if isinstance(job, int):
            # The first jobs are the slowest, so that answers come out of order.
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
            case "fork":
                # Both processes go on from here.
                os.fork()
                return "forked"
            case "forge":
                # As another process, for another job, and then correctly.
                for pid, number in ((os.getpid() + 1, int(argument)), (os.getpid(), int(argument) + 1)):
                    _pipe().send_bytes(ANSWER_HEADER.pack(pid, number) + pickle.dumps(JobFinished("forged")))
                return "true"
            case "fork and exit":
                if (child := os.fork()) == 0:
                    sys.exit(5)
                return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            case "once":
                return _once(Path(argument), job)
        return _die(word)


def _pipe() -> Connection:
    """This worker's."""
    return next(o for o in gc.get_objects() if isinstance(o, Connection) and o.readable and o.writable)


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
            # Starts an answer of a thousand bytes and never completes it.
            os.write(_pipe().fileno(), struct.pack("!i", 1000) + b"x")
            time.sleep(60)
