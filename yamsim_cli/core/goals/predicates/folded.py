"""Whether cloth is folded."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ...documents.units import Distance, Share
from ...geometry.folding import Fold, FoldWay, outline_area, sheet_area, ways_to_fold
from ...geometry.se3 import Array
from ..cast import Cast
from ..measure import Measure, either
from ..world import World
from .base import Predicate, still_held


class Folded(Predicate):
    """Each cloth is folded, lies flat, and no hand holds it.

    Attributes:
        thing: a role, which cloth plays.
        how: `half`, along either side; `diagonal`, along either one; or `thirds`, from either side, the last over the
            first.
        error: how far apart two points may be, seen from above, that lie on each other when it is folded exactly, m.
        area: by how much the share of its area that its outline covers may differ from that of an exact fold.
        height: how high any point may be over the lowest, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    IN_HAND: ClassVar[bool | None] = False
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    how: Fold = "half"
    error: Annotated[Distance, Field(gt=0)] = 0.02
    area: Annotated[Share, Field(gt=0)] = 0.1
    height: Annotated[Distance, Field(gt=0)] = 0.03

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [measure for thing in cast.of(self.thing) for measure in self._measures(world, thing)]

    def _measures(self, world: World, thing: str) -> list[Measure]:
        what = f"folded({thing}, {self.how})"
        if held := still_held(world, thing, what):
            return [held]
        points = world.points(thing)
        ways = ways_to_fold(self.how, *points.shape[:2])
        if not ways:
            return [either(what, False, "its grid of points does not allow it")]
        folded = min(ways, key=lambda way: _error(points, way))
        error, covered = _error(points, folded), outline_area(points[..., :2].reshape(-1, 2)) / sheet_area(points)
        high, order = float(np.ptp(points[..., 2])), _order(points, folded)
        off = abs(covered - folded.covered)
        return [
            Measure(what, self.error - error, "m", f"what lies on each other is {error * 1000:.1f} mm apart at most"),
            Measure(f"{what}: area", self.area - off, "share", f"it covers {covered:.1%} of its area"),
            Measure(f"{what}: layers", order, "m", f"the upper layer is {order * 1000:.1f} mm higher at least"),
            Measure(f"{what}: flat", self.height - high, "m", f"{high * 1000:.1f} mm high"),
        ]


def _at(points: Array, layer: NDArray[np.int_]) -> Array:
    there: Array = points[layer[:, 0], layer[:, 1]]
    return there


def _error(points: Array, way: FoldWay) -> float:
    """How far apart what lies on each other is at most, seen from above, m."""
    apart = [np.linalg.norm((_at(points, one) - _at(points, other))[:, :2], axis=1).max() for one, other in way.layers]
    return float(max(apart))


def _order(points: Array, way: FoldWay) -> float:
    """How much higher each layer is than the one below it at least, m; negative where they go through each other."""
    higher = np.concatenate([_at(points, one)[:, 2] - _at(points, other)[:, 2] for one, other in way.layers])
    # What was folded under lies the other way round.
    return float(max(higher.min(), -higher.max()))
