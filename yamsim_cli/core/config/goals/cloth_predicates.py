"""The predicates of goals that cloth fulfils."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, model_validator

from ...files.documents.config_base import Config
from ...files.documents.units import Distance, QuantityBounds, Share
from ...geometry.cloth_folding import ClothFoldKind, FoldPlan, fold_plans, outline_area, sheet_area
from ...geometry.se3 import Array
from .measure import GoalMeasure, binary_measure
from .predicate import PerObjectPredicate, failure_if_held
from .world import GoalWorld


class Folded(PerObjectPredicate):
    """Each cloth is folded, lies flat, and no hand holds it.

    Attributes:
        thing: a role of cloth.
        how: `half`, along either side; `diagonal`, along either diagonal; or `thirds`, from either side, the last third
            over the first.
        error: largest horizontal distance between two points that coincide in an exact fold, m.
        area: largest difference from an exact fold in the share of the cloth's area that its outline covers.
        height: largest height of a point above the lowest point, m.
    """

    IN_HAND: ClassVar[bool | None] = False
    JUDGES_CLOTH: ClassVar[bool] = True
    how: ClothFoldKind = "half"
    error: Annotated[Distance, Field(gt=0)] = 0.02
    area: Annotated[Share, Field(gt=0)] = 0.1
    height: Annotated[Distance, Field(gt=0)] = 0.03

    def _object_measures(self, world: GoalWorld, thing: str) -> list[GoalMeasure]:
        what = f"folded({thing}, {self.how})"
        if held := failure_if_held(world, thing, what):
            return [held]
        points = world.cloth_points(thing)
        ways = fold_plans(self.how, *points.shape[:2])
        if not ways:
            return [binary_measure(what, False, "its grid of points cannot be folded in this way")]
        folded = min(ways, key=lambda way: _fold_error(points, way))
        error, covered = _fold_error(points, folded), _covered_area_share(points)
        high, order = float(np.ptp(points[..., 2])), _layer_gap(points, folded)
        off = abs(covered - folded.covered)
        return [
            GoalMeasure(
                what, self.error - error, "m", f"points that lie on each other are at most {error * 1000:.1f} mm apart"
            ),
            GoalMeasure(f"{what}: area", self.area - off, "share", f"it covers {covered:.1%} of its area"),
            GoalMeasure(f"{what}: layers", order, "m", f"the upper layer is at least {order * 1000:.1f} mm higher"),
            GoalMeasure(f"{what}: flat", self.height - high, "m", f"{high * 1000:.1f} mm high"),
        ]


class Spread(PerObjectPredicate):
    """Each cloth lies flat in one layer, and no hand holds it.

    Attributes:
        thing: a role of cloth.
        area: least share of the cloth's area that its outline covers, seen from above.
        height: largest height of a point above the lowest point, m.
    """

    IN_HAND: ClassVar[bool | None] = False
    JUDGES_CLOTH: ClassVar[bool] = True
    area: Annotated[Share, Field(gt=0, lt=1)] = 0.95
    height: Annotated[Distance, Field(gt=0)] = 0.015

    def _object_measures(self, world: GoalWorld, thing: str) -> list[GoalMeasure]:
        what = f"spread({thing})"
        if held := failure_if_held(world, thing, what):
            return [held]
        points = world.cloth_points(thing)
        covered, high = _covered_area_share(points), float(np.ptp(points[..., 2]))
        return [
            GoalMeasure(what, covered - self.area, "share", f"it covers {covered:.1%} of its area"),
            GoalMeasure(f"{what}: flat", self.height - high, "m", f"{high * 1000:.1f} mm high"),
        ]


class FoldedSize(Config):
    """A cloth, and the largest size of its bounding box along the axes of `world`.

    Attributes:
        thing: a role of cloth.
        area: largest area of the box, seen from above, m2.
        share: instead of `area`, the largest area as a share of the box's area at the start.
        height: largest height of the box, m.
    """

    thing: str
    area: Annotated[FiniteFloat, QuantityBounds("m2", 1e-4, 4)] | None = None
    share: Annotated[Share, Field(gt=0)] | None = None
    height: Annotated[Distance, Field(gt=0)] = 0.04

    @model_validator(mode="after")
    def _exactly_one_given(self) -> Self:
        if (self.area is None) == (self.share is None):
            raise ValueError("give either `area` or `share`")
        return self

    def largest_box_area(self, world: GoalWorld, thing: str) -> float:
        """Return the largest area of the box of an object, m2."""
        if self.area is not None:
            return self.area
        assert self.share is not None  # checked with the config
        return self.share * _footprint(*world.start_aabb(thing))


class FoldedSmall(FoldedSize, PerObjectPredicate):
    """Each cloth lies flat, its bounding box along the axes of `world` is small seen from above, and no hand holds it.

    Attributes:
        thing: a role of cloth.
        area: largest area of the box, m2.
        share: instead of `area`, the largest area as a share of the box's area at the start.
        height: largest height of the box, m.
    """

    IN_HAND: ClassVar[bool | None] = False
    JUDGES_CLOTH: ClassVar[bool] = True

    def _object_measures(self, world: GoalWorld, thing: str) -> list[GoalMeasure]:
        what = f"folded_small({thing})"
        if held := failure_if_held(world, thing, what):
            return [held]
        low, high = world.aabb(thing)
        area, limit = _footprint(low, high), self.largest_box_area(world, thing)
        tall = float(high[2] - low[2])
        detail = f"its box covers {area * 1e4:.0f} cm2, of {limit * 1e4:.0f} allowed"
        return [
            GoalMeasure(what, limit - area, "m2", detail),
            GoalMeasure(f"{what}: flat", self.height - tall, "m", f"{tall * 1000:.1f} mm high"),
        ]


def _footprint(low: Array, high: Array) -> float:
    return float(np.prod((high - low)[:2]))


def _covered_area_share(points: Array) -> float:
    """Return the share of a cloth's area that its outline covers, seen from above."""
    return outline_area(points[..., :2].reshape(-1, 2)) / sheet_area(points)


def _layer_points(points: Array, layer: NDArray[np.int_]) -> Array:
    there: Array = points[layer[:, 0], layer[:, 1]]
    return there


def _fold_error(points: Array, plan: FoldPlan) -> float:
    """Return the largest horizontal distance between points that coincide in an exact fold, m."""
    pairs = [(_layer_points(points, one), _layer_points(points, other)) for one, other in plan.layers]
    return float(max(np.linalg.norm((one - other)[:, :2], axis=1).max() for one, other in pairs))


def _layer_gap(points: Array, plan: FoldPlan) -> float:
    """Return the least height of a layer above the layer below, m; negative if the layers intersect."""
    higher = np.concatenate(
        [_layer_points(points, one)[:, 2] - _layer_points(points, other)[:, 2] for one, other in plan.layers]
    )
    return float(max(higher.min(), -higher.max()))  # a fold from below reverses the order of the layers
