"""Whether cloth is spread out."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from ...documents.units import Distance, Share
from ...geometry.folding import outline_area, sheet_area
from ..cast import Cast
from ..measure import Measure
from ..world import World
from .base import Predicate, still_held


class Spread(Predicate):
    """Each cloth lies flat in one layer, and no hand holds it.

    Attributes:
        thing: a role, which cloth plays.
        area: the share of its area that its outline covers at least, seen from above.
        height: how high any point may be over the lowest, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    IN_HAND: ClassVar[bool | None] = False
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    area: Annotated[Share, Field(gt=0, lt=1)] = 0.95
    height: Annotated[Distance, Field(gt=0)] = 0.015

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [measure for thing in cast.of(self.thing) for measure in self._measures(world, thing)]

    def _measures(self, world: World, thing: str) -> list[Measure]:
        what = f"spread({thing})"
        if held := still_held(world, thing, what):
            return [held]
        points = world.points(thing)
        covered = outline_area(points[..., :2].reshape(-1, 2)) / sheet_area(points)
        high = float(np.ptp(points[..., 2]))
        return [
            Measure(what, covered - self.area, "share", f"it covers {covered:.1%} of its area"),
            Measure(f"{what}: flat", self.height - high, "m", f"{high * 1000:.1f} mm high"),
        ]
