"""The margin by which a predicate holds or fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class GoalMeasure:
    """The margin by which a predicate holds or fails.

    Attributes:
        what: the predicate with its arguments, such as `on(cup, plate)`.
        margin: at least 0 if the predicate holds, negative if it fails; in units of `unit`.
        unit: "m", "m2", "deg", "g", "share", or "" for a binary predicate, whose margins are 0 and -1.
        detail: the measured values behind the margin, as text.
    """

    what: str
    margin: float
    unit: str
    detail: str = ""

    @property
    def holds(self) -> bool:
        """Whether the predicate holds."""
        return self.margin >= 0


def binary_measure(what: str, holds: bool, detail: str = "") -> GoalMeasure:
    """Return the measure of a binary predicate."""
    return GoalMeasure(what, 0.0 if holds else -1.0, "", detail)


def worst_measure(measures: Sequence[GoalMeasure]) -> GoalMeasure:
    """Return the first measure that fails, or else the measure with the least margin."""
    failing = [measure for measure in measures if not measure.holds]
    return failing[0] if failing else min(measures, key=lambda measure: measure.margin)
