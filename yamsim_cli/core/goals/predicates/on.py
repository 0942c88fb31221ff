"""Whether things rest on a surface."""

from __future__ import annotations

from typing import ClassVar

from ...documents.units import Distance
from ..cast import Cast
from ..measure import Measure, either
from ..world import TABLE, World
from ._shapes import overlap_xy
from .base import Predicate, still_held


class On(Predicate):
    """Each thing touches its surface, its middle lies over it, and no hand holds it.

    Attributes:
        thing, surface: roles; the surface may be `table`.
        inside: how far inside the surface's outline the thing's middle has to lie, m.
        radius: rather, how near the two origins have to be seen from above, m. A thing that also touches the table
            leans against its surface, and does not count.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "surface")
    IN_HAND: ClassVar[bool | None] = False
    thing: str
    surface: str
    inside: Distance = 0.0
    radius: Distance | None = None

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        if self.surface == TABLE:
            return [self._measure(world, thing, TABLE) for thing in cast.of(self.thing)]
        return [self._measure(world, *pair) for pair in cast.pairs(self.thing, self.surface)]

    def _measure(self, world: World, thing: str, surface: str) -> Measure:
        what = f"on({thing}, {surface})"
        if held := still_held(world, thing, what):
            return held
        if not world.touching(thing, surface):
            return either(what, False, "they do not touch")
        if surface == TABLE:
            return either(what, True)
        if self.radius is not None:
            # What leans against a thing stands on the table, however near the two origins are.
            if world.touching(thing, TABLE):
                return either(what, False, "touches the table")
            apart = world.pose(thing)[:2, 3] - world.pose(surface)[:2, 3]
            distance = float((apart @ apart) ** 0.5)
            return Measure(what, self.radius - distance, "m", f"{distance * 1000:.0f} mm from the middle")
        inside = overlap_xy(world, thing, surface)
        return Measure(what, inside - self.inside, "m", f"its middle {inside * 1000:.0f} mm inside the outline")
