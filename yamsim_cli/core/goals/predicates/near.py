"""Whether things are near to others, or to a place."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from ...documents.units import Distance, Place
from ..cast import Cast
from ..measure import Measure
from ..world import World
from .base import Predicate

Side = Literal["left", "right", "front", "behind"]

# Each side's direction in `world`, seen from the robot's base.
_AXES = {"left": (0.0, 1.0), "right": (0.0, -1.0), "front": (-1.0, 0.0), "behind": (1.0, 0.0)}


class Near(Predicate):
    """Each thing's origin is within `radius` of another's, or of a place, seen from above, and on a side of it.

    Sides are seen from the robot's base along x of `world`: `left` is +y, `right` is -y, `behind` is +x (farther away)
    and `front` is -x (nearer). A side is a quarter circle: 45 degrees to either side of its axis.

    Attributes:
        thing, other: roles.
        place: rather than another thing, x and y in `world`, m.
        radius: how near, m.
        side: on which side of the other thing, or of the place: `left`, `right`, `front` or `behind`.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    thing: str
    other: str | None = None
    place: tuple[Place, Place] | None = None
    radius: Annotated[Distance, Field(gt=0)]
    side: Annotated[Side | None, Field(exclude_if=lambda side: side is None)] = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Near:
        if (self.other is None) == (self.place is None):
            raise ValueError("give either `other` or `place`")
        return self

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        if self.other is None:
            return [self._measure(world, thing, "place", np.array(self.place)) for thing in cast.of(self.thing)]
        return [
            self._measure(world, thing, other, world.pose(other)[:2, 3])
            for thing, other in cast.pairs(self.thing, self.other)
        ]

    def _measure(self, world: World, thing: str, other: str, place: np.ndarray) -> Measure:
        off = world.pose(thing)[:2, 3] - place
        distance = float(np.linalg.norm(off))
        margin, said = self.radius - distance, f"{distance * 1000:.0f} mm away"
        if self.side is None:
            return Measure(f"near({thing}, {other})", margin, "m", said)
        axis = np.array(_AXES[self.side])
        along, across = float(off @ axis), abs(float(axis[0] * off[1] - axis[1] * off[0]))
        # How far the thing is inside the quarter circle's nearer edge.
        inside = (along - across) / math.sqrt(2)
        said += f", {along * 1000:.0f} mm of it to the side {self.side!r}"
        return Measure(f"near({thing}, {other}, {self.side})", min(margin, inside), "m", said)
