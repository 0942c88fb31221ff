"""Receives teleoperated attempts, without a recorder."""

from __future__ import annotations

from tests.attempts import all_actions
from yamsim_cli.core.attempt_data import ActionSequence
from yamsim_cli.core.episode.execution import SimulatedAttempt


class CollectingReceiver:
    """Keeps submitted attempts."""

    def __init__(self) -> None:
        self.attempts: list[SimulatedAttempt] = []

    @property
    def next_attempt(self) -> int:
        return len(self.attempts)

    def submit(self, simulated: SimulatedAttempt) -> None:
        self.attempts.append(simulated)

    @property
    def actions(self) -> ActionSequence:
        """Actions of the first submitted attempt."""
        return all_actions(self.attempts[0].recorded_states)
