"""Ctrl-C and SIGTERM: noted where nothing may be interrupted, raised as KeyboardInterrupt otherwise."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yamsim_cli.core.workers.stop_request import StopRequest

_ENDING = (signal.SIGINT, signal.SIGTERM)
_STDERR = 2  # file descriptor
_RETRY_SECONDS = 0.02  # s until a signal during an import is raised again


@contextmanager
def defer_signals() -> Iterator[Callable[[], bool]]:
    """A function that returns whether a signal has come; inside the block, no signal raises."""
    came = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True

    before = {number: signal.signal(number, note) for number in _ENDING}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def stop_on_signal(message: str) -> Iterator[StopRequest]:
    """A stop that is requested by the first signal or a closed terminal; a second signal ends the block at once.

    Args:
        message: written to stderr on the first signal.
    """
    from yamsim_cli.core.workers.stop_request import StopRequest

    stop = StopRequest()

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_requested:
            _interrupt(number, frame)
        stop.request()
        # The handler may have interrupted a write to sys.stderr, which must not be entered twice.
        with suppress(OSError):
            os.write(_STDERR, f"{message}\n".encode())

    # Under nohup, the hang-up stays ignored.
    wanted = [number for number in (*_ENDING, signal.SIGHUP) if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, ask) for number in wanted}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def raise_signals() -> None:
    """From now on, a signal raises KeyboardInterrupt: at once, or at the end of an import in progress."""
    for number in (*_ENDING, signal.SIGALRM):
        signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    # An interrupted import of an extension module looks like a missing module, which its library may then do without.
    if _importing(frame):
        signal.setitimer(signal.ITIMER_REAL, _RETRY_SECONDS)
        return
    raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
