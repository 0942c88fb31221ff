"""By what margin a predicate holds or fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class GoalMeasure:
    """By what margin a predicate holds or fails.

    Attributes:
        what: the predicate with its arguments, such as `on(cup, plate)`.
        margin: zero or more where the predicate holds, negative where it fails; in units of `unit`.
        unit: "m", "deg", "share", or "" for a predicate without degrees, whose margins are 0 and -1.
        detail: the figures behind the margin, for a person.
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
    """The measure of a predicate without degrees."""
    return GoalMeasure(what, 0.0 if holds else -1.0, "", detail)


def worst_measure(measures: Sequence[GoalMeasure]) -> GoalMeasure:
    """The first measure that fails, else the measure with the least margin."""
    failing = [measure for measure in measures if not measure.holds]
    return failing[0] if failing else min(measures, key=lambda measure: measure.margin)
