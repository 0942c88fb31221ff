"""Code of the user's, run under a time limit; whatever it does wrong is its own failure and nobody else's."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from ..policies.base import InvalidActionError
from ..policies.peer import RemoteError
from ..policies.policy_faults import Fault, fault_of
from ..workers.serving import forks_end_here

T = TypeVar("T")


class PolicyFailedError(Exception):
    """The policy raised something.

    Attributes:
        fault: what.
    """

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.text)
        self.fault = fault


class TooSlowError(Exception):
    """The policy did not answer in time."""


class Asker:
    """Asks a policy, under a time limit that stands still while the policy waits for yamsim.

    Attributes:
        seconds: how long the last question took, without such waits.

    Args:
        limit: seconds for one question.
        folder: where the policy's files are looked for, to name them.
    """

    def __init__(self, limit: float, folder: Path) -> None:
        self._limit, self._folder = limit, folder
        self.seconds = 0.0
        self._waited = 0.0

    def ask(self, question: Callable[[], T]) -> T:
        """The answer to a question.

        Raises:
            PolicyFailedError: it raised something.
            TooSlowError: there was none in time.
            InvalidActionError: a server says that the answer is none.
        """
        began, self._waited = time.monotonic(), 0.0
        try:
            with talking_on_stderr(), self._limited(), forks_end_here():
                return question()
        except (TooSlowError, TimeoutError) as error:
            raise TooSlowError from error
        except InvalidActionError:
            raise
        except RemoteError as error:
            raise PolicyFailedError(error.fault) from error
        # Code of others may raise anything; it costs this trial alone.
        except Exception as error:
            raise PolicyFailedError(fault_of(error, self._folder)) from error
        finally:
            self.seconds = time.monotonic() - began - self._waited

    @contextlib.contextmanager
    def waits(self) -> Iterator[None]:
        """Stop the clock: in this block the policy waits for yamsim."""
        began = time.monotonic()
        left = signal.setitimer(signal.ITIMER_REAL, 0)[0]
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, left)
            self._waited += time.monotonic() - began

    @contextlib.contextmanager
    def _limited(self) -> Iterator[None]:
        """Raise in the block when it takes longer; what does not come back to Python at all is left to the worker
        pool.
        """

        def ring(number: int, frame: FrameType | None) -> None:
            raise TooSlowError

        before = signal.signal(signal.SIGALRM, ring)
        # Workers are born deaf to it.
        mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
        signal.setitimer(signal.ITIMER_REAL, self._limit)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            signal.signal(signal.SIGALRM, before)


def talking_on_stderr() -> contextlib.AbstractContextManager[Any]:
    """What a policy prints must not get into a report on stdout."""
    return contextlib.redirect_stdout(sys.stderr)
