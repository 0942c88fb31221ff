"""What Ctrl-C, SIGTERM and a closed terminal mean to a command that can end in good order."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yamsim_cli.core.jobs.stop import Stop

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_STDERR = 2


@contextmanager
def stoppable(message: str) -> Iterator[Stop]:
    """For the block, the first signal asks it to stop, and a second one ends it at once with KeyboardInterrupt.

    Args:
        message: shown on the first signal.
    """
    from yamsim_cli.core.jobs.stop import Stop

    stop = Stop()

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.asked:
            raise KeyboardInterrupt
        stop.ask()
        # The handler may have interrupted a write to sys.stderr, which must not be entered twice.
        with suppress(OSError):
            os.write(_STDERR, f"{message}\n".encode())

    # nohup has the hang-up ignored: that is to stay so.
    wanted = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, ask) for number in wanted}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
