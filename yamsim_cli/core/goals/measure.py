"""What came of asking a predicate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Measure:
    """How far a predicate is from changing its answer.

    Attributes:
        what: the predicate as asked, such as `on(cup, plate)`.
        margin: zero or more where it holds, less where it does not; in units of `unit`.
        unit: "m", "deg", "share", or "" for one that either holds or does not, with margins 0 and -1.
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


def either(what: str, holds: bool, detail: str = "") -> Measure:
    """The measure of a predicate that knows no degrees."""
    return Measure(what, 0.0 if holds else -1.0, "", detail)


def worst(measures: Sequence[Measure]) -> Measure:
    """The measure with the least margin; of those that fail, the first."""
    failing = [measure for measure in measures if not measure.holds]
    return failing[0] if failing else min(measures, key=lambda measure: measure.margin)
