"""Whether two things changed places."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from ...documents.units import Distance
from ..cast import Cast
from ..measure import Measure
from ..world import World
from .base import Predicate


class Swapped(Predicate):
    """Each of two things lies where the other one started, seen from above.

    Attributes:
        thing, other: roles.
        radius: how near to the other's start, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    thing: str
    other: str
    radius: Annotated[Distance, Field(gt=0)] = 0.03

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        one, other = cast.one(self.thing), cast.one(self.other)
        return [self._measure(world, one, other), self._measure(world, other, one)]

    def _measure(self, world: World, thing: str, other: str) -> Measure:
        off = float(np.linalg.norm(world.pose(thing)[:2, 3] - world.start(other)[:2, 3]))
        said = f"{off * 1000:.0f} mm from where the {other} started"
        return Measure(f"swapped({thing}, {other})", self.radius - off, "m", said)
