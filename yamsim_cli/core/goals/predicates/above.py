"""Whether things are higher than others."""

from __future__ import annotations

from typing import ClassVar

from ...documents.units import Distance
from ..cast import Cast
from ..measure import Measure
from ..world import TABLE, World
from ._shapes import bottom, top
from .base import Predicate


class Above(Predicate):
    """Each thing's lowest point is so much higher than another's highest.

    Attributes:
        thing, other: roles; the other may be `table`.
        by: how much higher, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    thing: str
    other: str
    by: Distance = 0.0

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        pairs = ((thing, TABLE) for thing in cast.of(self.thing))
        return [
            self._measure(world, *pair)
            for pair in (pairs if self.other == TABLE else cast.pairs(self.thing, self.other))
        ]

    def _measure(self, world: World, thing: str, other: str) -> Measure:
        height = bottom(world, thing) - top(world, other)
        return Measure(f"above({thing}, {other})", height - self.by, "m", f"{height * 1000:.0f} mm over it")
