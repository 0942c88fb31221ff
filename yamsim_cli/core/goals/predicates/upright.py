"""Whether things stand upright."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field, FiniteFloat

from ..cast import Cast
from ..measure import Measure
from ..world import World
from ._shapes import tilt_of
from .base import Predicate


class Upright(Predicate):
    """The z axis of each thing points up, to so many degrees.

    Attributes:
        thing: a role.
        tilt_deg: the most that it may lean.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str
    tilt_deg: Annotated[FiniteFloat, Field(gt=0, lt=180)] = 15.0

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, thing) for thing in cast.of(self.thing)]

    def _measure(self, world: World, thing: str) -> Measure:
        tilt = math.degrees(tilt_of(world.pose(thing)))
        return Measure(f"upright({thing})", self.tilt_deg - tilt, "deg", f"it leans by {tilt:.1f} deg")
