"""What became of an attempt."""

from __future__ import annotations

from dataclasses import dataclass

from ..sim.rollout import Rollout
from ..types import Attempt, Outcome, StepState


@dataclass(frozen=True)
class Simulated:
    """An attempt, and what became of it.

    Attributes:
        attempt: as it began, with its distractors where they were placed.
        outcome: how it ended.
        rollout: what happened; None where nothing moved.
    """

    attempt: Attempt
    outcome: Outcome
    rollout: Rollout | None

    @property
    def states(self) -> tuple[StepState, ...]:
        """Of every recorded frame; none where nothing moved."""
        return self.rollout.states if self.rollout else ()
