"""Handle Ctrl-C (SIGINT) and SIGTERM: note them inside protected blocks, and raise KeyboardInterrupt elsewhere."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yamsim_cli.core.workers.stop_request import StopRequest

_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_STDERR = 2  # file descriptor of stderr
_RETRY_SECONDS = 0.02  # s by which a signal during an import is postponed


@contextmanager
def defer_signals() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether a signal has arrived. In the block, signals raise no exception."""
    came = False

    def note_signal(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True

    before = {number: signal.signal(number, note_signal) for number in _STOP_SIGNALS}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def stop_on_signal(message: str) -> Iterator[StopRequest]:
    """Yield a stop request that the first signal or a closed terminal sets. The second raises KeyboardInterrupt.

    In an `uninterrupted` block of the request, the second raises at the end of the block, and the third immediately.
    Only the first prints `message`.
    """
    from yamsim_cli.core.workers.stop_request import StopRequest

    stop = StopRequest()

    def interrupt(number: int, frame: FrameType | None) -> None:
        if not stop.postpone_interrupt():
            _raise_interrupt(number, frame)

    def request_stop(number: int, frame: FrameType | None) -> None:
        if stop.is_requested:
            interrupt(number, frame)
            return
        stop.request_stop()
        # The handler may have interrupted a write to sys.stderr, which is not reentrant.
        with suppress(OSError):
            os.write(_STDERR, f"{message}\n".encode())

    # Signals that are ignored already, such as SIGHUP under nohup, stay ignored.
    wanted = [number for number in (*_STOP_SIGNALS, signal.SIGHUP) if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, request_stop) for number in wanted}
    # `_raise_interrupt` sets an alarm for a signal that arrives during an import.
    before[signal.SIGALRM] = signal.signal(signal.SIGALRM, interrupt)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def raise_signals() -> None:
    """Make later signals raise KeyboardInterrupt at once, or after an import that is in progress."""
    for number in (*_STOP_SIGNALS, signal.SIGALRM):
        signal.signal(number, _raise_interrupt)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    # A library whose import of an extension module is interrupted may treat the module as missing.
    if _is_importing(frame):
        signal.setitimer(signal.ITIMER_REAL, _RETRY_SECONDS)
        return
    raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
