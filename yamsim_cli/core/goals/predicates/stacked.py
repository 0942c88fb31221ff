"""Whether things stand on each other."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar, Literal

from ..cast import Cast
from ..measure import Measure, either
from ..world import World
from ._shapes import bottom, overlap_xy
from .base import Predicate, still_held


class Stacked(Predicate):
    """The things of a role stand on, or in, one another, each one's middle over the one below.

    Attributes:
        things: a role that several play.
        order: "any", or "given": the role's first thing lowest, and so on.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    things: str
    order: Literal["any", "given"] = "any"

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        names = list(cast.of(self.things))
        if self.order == "any":
            names.sort(key=lambda name: bottom(world, name))
        return [self._measure(world, lower, upper) for lower, upper in pairwise(names)]

    @staticmethod
    def _measure(world: World, lower: str, upper: str) -> Measure:
        what = f"stacked({upper} on {lower})"
        if held := still_held(world, upper, what):
            return held
        if not world.touching(upper, lower):
            return either(what, False, "they do not touch")
        if bottom(world, upper) <= bottom(world, lower):
            return either(what, False, "it is not the higher one")
        inside = overlap_xy(world, upper, lower)
        return Measure(what, inside, "m", f"its middle {inside * 1000:.0f} mm inside the lower one's outline")
