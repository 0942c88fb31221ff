"""Whether things rest over a surface, by the blocks that enclose them."""

from __future__ import annotations

from typing import ClassVar

from ...documents.units import Distance
from ..cast import Cast
from ..measure import Measure
from ..world import World
from ._shapes import bottom, overlap_xy, top
from .base import Predicate


class Over(Predicate):
    """The middle of each thing's block lies over its surface's, and its bottom is as high as the surface's top.

    Unlike `on`, it asks neither for a touch nor whether a hand holds the thing: the block of a plate ends at its rim.

    Attributes:
        thing, surface: roles.
        gap: how far bottom and top may be apart, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "surface")
    thing: str
    surface: str
    gap: Distance = 0.02

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, *pair) for pair in cast.pairs(self.thing, self.surface)]

    def _measure(self, world: World, thing: str, surface: str) -> Measure:
        inside = overlap_xy(world, thing, surface)
        apart = bottom(world, thing) - top(world, surface)
        detail = f"{inside * 1000:.0f} mm inside the outline, {apart * 1000:.0f} mm above the top"
        return Measure(f"over({thing}, {surface})", min(inside, self.gap - abs(apart)), "m", detail)
