"""Whether things are piled up, by the blocks that enclose them."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar

from pydantic import Field

from ...documents.units import Distance
from ..cast import Cast
from ..measure import Measure
from ..world import World
from ._shapes import bottom, overlap_xy, top
from .base import Predicate


class Piled(Predicate):
    """From the lowest to the highest, the middle of each thing's block lies over the one below, whose bottom is lower
    and whose top is not far below: a cup may stand in the one that it is piled onto.

    Unlike `stacked`, it asks neither for a touch nor whether a hand holds a thing.

    Attributes:
        things: roles; all that play them are one pile.
        gap: how far a bottom may be above the top of what is below, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    things: Annotated[tuple[str, ...], Field(min_length=1)]
    gap: Distance = 0.02

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        names = sorted((name for role in self.things for name in cast.of(role)), key=lambda name: bottom(world, name))
        return [self._measure(world, lower, upper) for lower, upper in pairwise(names)]

    def roles(self) -> tuple[tuple[str, str], ...]:
        """See `Predicate`."""
        return tuple(("things", role) for role in self.things)

    def _measure(self, world: World, lower: str, upper: str) -> Measure:
        inside, higher = overlap_xy(world, upper, lower), bottom(world, upper) - bottom(world, lower)
        apart = bottom(world, upper) - top(world, lower)
        margin = min(inside, self.gap - apart)
        # Of two that are equally low, neither is on the other.
        if higher <= 0:
            margin = min(margin, -1e-9)
        detail = f"{inside * 1000:.0f} mm inside the outline, {apart * 1000:.0f} mm above the top"
        return Measure(f"piled({upper} on {lower})", margin, "m", detail)
