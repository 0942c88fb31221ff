"""Run another program for a source: quietly, with time limits, leaving no process behind."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .sources import SourceError

_POLL_S = 0.1


@dataclass(frozen=True)
class ChildResult:
    """How a program ended, and all it wrote."""

    returncode: int
    stdout: str
    stderr: str


def run_child(
    command: Sequence[str], scratch: Path, *, limit_s: float, idle_s: float, watch: Callable[[], int] | None = None
) -> ChildResult:
    """Run `command` to its end, or end it and everything it started.

    Args:
        command: the program and its arguments; it inherits the environment.
        scratch: where its output is collected, so that no full pipe can block it.
        limit_s: how long it may take in all.
        idle_s: how long `watch` may stay at one value: a dead line is given up early, a slow one is not.
        watch: how far the program is; asked ten times a second.

    Raises:
        SourceError: it could not be started, or a limit was reached.
    """
    out, err = scratch / "stdout.txt", scratch / "stderr.txt"
    with out.open("wb") as stdout, err.open("wb") as stderr:
        try:
            # A session of its own: it can be ended with its children, and Ctrl-C reaches it only through us.
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr, start_new_session=True
            )
        except OSError as error:
            raise SourceError(f"cannot run {command[0]}: {error.strerror}") from error
        try:
            _wait(child, limit_s, idle_s, watch)
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
                child.wait()
    return ChildResult(child.returncode, out.read_text(errors="replace"), err.read_text(errors="replace"))


def _wait(child: subprocess.Popen[bytes], limit_s: float, idle_s: float, watch: Callable[[], int] | None) -> None:
    start = moved = time.monotonic()
    seen = None
    while True:
        try:
            child.wait(_POLL_S)
            return
        except subprocess.TimeoutExpired:
            now = time.monotonic()
        if watch is not None and (value := watch()) != seen:
            seen, moved = value, now
        if now - start > limit_s:
            raise SourceError(f"not done after {limit_s:g} s")
        if watch is not None and now - moved > idle_s:
            raise SourceError(f"nothing arrived for {idle_s:g} s")
