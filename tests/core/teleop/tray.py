"""Where driven attempts are handed in, without a recorder."""

from __future__ import annotations

from yamsim_cli.core.teleop.desk import DrivenAttempt


class Tray:
    """Takes what is handed in, and leaves it."""

    def __init__(self) -> None:
        self.attempts: list[DrivenAttempt] = []

    @property
    def next_attempt(self) -> int:
        return len(self.attempts)

    def hand_in(self, driven: DrivenAttempt) -> None:
        self.attempts.append(driven)
