from __future__ import annotations

import ctypes
import functools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .sources import SourceError

_POLL_S = 0.1  # between two polls of the child process
_PR_SET_PDEATHSIG = 1  # option of prctl(2)
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None  # loaded early: a forked child must not take locks


@dataclass(frozen=True)
class ChildResult:
    """The result of a program that has ended."""

    returncode: int
    stdout: str
    stderr: str


def python_call_command(function: Callable[..., object], *arguments: str | int) -> list[str]:
    """Return the command that calls a module-level function of yamsim in another Python process.

    -P prevents imports from the current folder.
    """
    module, name = function.__module__, function.__qualname__
    root = str(Path(__file__).resolve().parents[4])
    code = f"import sys; sys.path.insert(0, {root!r}); from {module} import {name}; {name}(*{arguments!r})"
    return [sys.executable, "-P", "-c", code]


def run_child(
    command: Sequence[str], scratch: Path, *, limit_s: float, idle_s: float, watch: Callable[[], int] | None = None
) -> ChildResult:
    """Run a program to its end. At a time limit, kill it and its children, and raise SourceError.

    Args:
        scratch: folder for files with the program's output, so that no full pipe can block the program.
        limit_s: longest total time.
        idle_s: longest time without a change of `watch`. This limit ends dead downloads but not slow ones.
        watch: a number that changes as the program progresses, such as bytes; called ten times a second.
    """
    out, err = scratch / "stdout.txt", scratch / "stderr.txt"
    with out.open("wb") as stdout, err.open("wb") as stderr:
        try:
            # A separate session can be killed as a whole, and Ctrl-C in the terminal does not reach it.
            child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                start_new_session=True,
                preexec_fn=functools.partial(_end_with_parent, os.getpid()),
            )
        except OSError as error:
            raise SourceError(f"cannot run {command[0]}: {error.strerror}") from error
        try:
            _wait_for_child(child, limit_s, idle_s, watch)
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
                child.wait()
    return ChildResult(child.returncode, out.read_text(errors="replace"), err.read_text(errors="replace"))


def _end_with_parent(parent: int) -> None:
    """Let the kernel kill this new child process when its parent ends for any reason."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)


def _wait_for_child(
    child: subprocess.Popen[bytes], limit_s: float, idle_s: float, watch: Callable[[], int] | None
) -> None:
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
