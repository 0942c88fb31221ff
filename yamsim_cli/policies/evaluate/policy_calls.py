"""Call a policy's code under a time limit, and distinguish its errors from yamsim's."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from yamsim_cli.core.workers.job_server import kill_forks_at_exit

from ..policy_client import RemoteError
from ..policy_faults import PolicyFault, describe_fault
from ..policy_protocol import InvalidActionError, Observation, Policy
from .observation import ObservationRenderer

T = TypeVar("T")


class PolicyFailedError(Exception):
    """The policy raised an exception."""

    def __init__(self, fault: PolicyFault) -> None:
        super().__init__(fault.text)
        self.fault = fault


class PolicyTimeoutError(Exception):
    """The policy did not answer in time."""


class PolicyCaller:
    """Calls a policy under a time limit, which pauses while the policy waits for yamsim.

    Attributes:
        seconds: duration of the last call, without the time in `paused_limit` blocks, s.

    Args:
        limit: time limit of a call, s.
    """

    def __init__(self, limit: float, folder: Path) -> None:
        self._limit, self._folder = limit, folder
        self.seconds = 0.0
        self._waited = 0.0

    def call(self, function: Callable[[], T]) -> T:
        """Call a function of the policy. Raise PolicyFailedError, PolicyTimeoutError or InvalidActionError."""
        began, self._waited = time.monotonic(), 0.0
        try:
            with output_on_stderr(), self._time_limit(), kill_forks_at_exit():
                return function()
        except (PolicyTimeoutError, TimeoutError) as error:
            raise PolicyTimeoutError from error
        except InvalidActionError:
            raise
        except RemoteError as error:
            raise PolicyFailedError(error.fault) from error
        # A policy may raise any exception, which fails only its trial.
        except Exception as error:
            raise PolicyFailedError(describe_fault(error, self._folder)) from error
        finally:
            self.seconds = time.monotonic() - began - self._waited

    def request(self, policy: Policy, observation: Observation, renderer: ObservationRenderer) -> object:
        """Return a policy's answer to an observation. Raise as `call`, or the error of rendering its images."""
        try:
            return self.call(lambda: policy(observation))
        finally:
            if renderer.failure is not None:
                raise renderer.failure

    def close(self, policy: Policy) -> None:
        """Close a policy that has `close`, and ignore its faults."""
        close = getattr(policy, "close", None)
        if callable(close):
            with contextlib.suppress(PolicyFailedError, PolicyTimeoutError):
                self.call(close)

    @contextlib.contextmanager
    def paused_limit(self) -> Iterator[None]:
        """Pause the time limit while yamsim renders an image."""
        began = time.monotonic()
        left = signal.setitimer(signal.ITIMER_REAL, 0)[0]
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, left)
            self._waited += time.monotonic() - began

    @contextlib.contextmanager
    def _time_limit(self) -> Iterator[None]:
        """Raise PolicyTimeoutError in the block when the time limit is over."""
        # The worker pool terminates code that never returns to Python.

        def raise_timeout(number: int, frame: FrameType | None) -> None:
            raise PolicyTimeoutError

        before = signal.signal(signal.SIGALRM, raise_timeout)
        # Workers start with a blocked SIGALRM.
        mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
        signal.setitimer(signal.ITIMER_REAL, self._limit)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            signal.signal(signal.SIGALRM, before)


def output_on_stderr() -> contextlib.AbstractContextManager[Any]:
    """Redirect a policy's output to stderr, because stdout may carry a report."""
    return contextlib.redirect_stdout(sys.stderr)
