"""Smooth folded cloth of which a part stands up, such as a wrinkle or a crease."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..core.expert.skills.cloth.cloth_motions import carry_points, predict_cloth_points
from ..core.expert.skills.cloth.flatten import PULL_SPEED, pull_placements
from ..core.expert.skills.cloth.point_grasps import PointGrasp, reachable_grasps
from ..core.expert.skills.common_motions import open_and_park_hands
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext
from ..core.geometry.cloth_flattening import candidate_pulls, height_range
from ..core.geometry.se3 import Array
from .pressing import press_point

_PULL_SHARES = (1.0, 0.5)  # of the pulls that straighten flat cloth
_MIN_IMPROVEMENT = 0.1  # share by which a pull must reduce the height
_PRESSED_HEIGHT = 0.012  # m over the lowest point, of the tips that press a crease down; several layers lie under it


def smooth_folded_cloth(context: PlanningContext, thing: str, max_area: float) -> Iterator[MotionSegment]:
    """Pull the border of a folded cloth so that it becomes lower, or press its highest point down.

    The pull with the lowest simulated result is used, if the cloth's box, seen from above, then covers at most
    `max_area` (m2). If no pull makes the cloth lower, a hand presses on its highest point.
    """
    yield from open_and_park_hands(context)
    if (grasps := _lowering_grasps(context, thing, max_area)) is not None:
        yield from carry_points(context, thing, grasps, 0.0, PULL_SPEED)
        return
    points = context.world.cloth_points(thing).reshape(-1, 3)
    highest = points[points[:, 2].argmax()]
    yield from press_point(context, highest, float(highest[2] - points[:, 2].min()) - _PRESSED_HEIGHT)


def _lowering_grasps(context: PlanningContext, thing: str, max_area: float) -> list[PointGrasp] | None:
    cloth, points = context.world.cloth_addresses(thing), context.world.cloth_points(thing)
    best, lowest = None, (1 - _MIN_IMPROVEMENT) * height_range(points)
    for pull in candidate_pulls(points, cloth.flat_points, cloth.thickness, cloth.max_point_spacing):
        if pull.arch_ratio:
            continue  # such a pull unfolds the cloth
        for share in _PULL_SHARES:
            grasps = reachable_grasps(context, thing, pull_placements(points, pull, share, cloth.thickness))
            if grasps is None:
                continue
            after = predict_cloth_points(context, thing, grasps, 0.0, PULL_SPEED)
            if bounding_box_area(after) <= max_area and height_range(after) < lowest:
                best, lowest = grasps, height_range(after)
    return best


def bounding_box_area(points: Array) -> float:
    """Return the area of the box along the axes of `world` around points (..., 3), seen from above, m2."""
    return float(np.prod(np.ptp(points.reshape(-1, 3)[:, :2], axis=0)))
