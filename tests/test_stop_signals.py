"""Signals that arrive while a job writes an episode."""

from __future__ import annotations

import os
import signal

import pytest

from yamsim_cli.terminal.signals import stop_on_signal


@pytest.mark.parametrize("later", [signal.SIGTERM, signal.SIGALRM])
def test_a_later_signal_waits_for_the_end_of_the_block(
    later: signal.Signals, capfd: pytest.CaptureFixture[str]
) -> None:
    """SIGALRM stands for a signal that arrived during an import, and was postponed."""
    steps = []
    with stop_on_signal("stopping") as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt), stop.uninterrupted():
            os.kill(os.getpid(), later)
            steps.append("written")
    assert (steps, capfd.readouterr().err) == (["written"], "stopping\n")


def test_an_interrupt_is_forgotten_if_the_block_fails() -> None:
    with stop_on_signal("stopping") as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(ValueError, match="disk"), stop.uninterrupted():
            os.kill(os.getpid(), signal.SIGTERM)
            raise ValueError("disk")
        with stop.uninterrupted():
            pass
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
