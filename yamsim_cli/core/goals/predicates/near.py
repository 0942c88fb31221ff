"""Whether things are near to others, or to a place."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from ...documents.units import Distance, Place
from ..cast import Cast
from ..measure import Measure
from ..world import World
from .base import Predicate


class Near(Predicate):
    """Each thing's origin is as near as `radius` to another's, or of a place, seen from above.

    Attributes:
        thing, other: roles.
        place: rather than another thing, x and y in `world`, m.
        radius: how near, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    thing: str
    other: str | None = None
    place: tuple[Place, Place] | None = None
    radius: Annotated[Distance, Field(gt=0)]

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
        distance = float(np.linalg.norm(world.pose(thing)[:2, 3] - place))
        return Measure(f"near({thing}, {other})", self.radius - distance, "m", f"{distance * 1000:.0f} mm away")
