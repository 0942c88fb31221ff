from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

from ..core.expert.skills.cloth.cloth_motions import predict_cloth_points
from ..core.expert.skills.cloth.point_grasps import (
    PointGrasp,
    PointPlacement,
    reachable_grasps,
    target_at_place,
)
from ..core.expert.skills.planning_context import PlanningContext
from ..core.geometry.cloth_flattening import height_range
from ..core.geometry.se3 import Array, rotation_z

SLIDE_SPEED = 0.2  # m/s
MAX_SLID_HEIGHT = 0.045  # m, of the highest point of a cloth over its lowest one, before and after a slide

# m, slides towards the arms, in the order tried: a cloth that is pulled by its nearer side follows straight
_SLIDE_LENGTHS = (0.1, 0.15, 0.05, 0.0, -0.05)

_MAX_TRIALS = 8  # slides that are simulated; each takes long


def find_slide_grasps(
    context: PlanningContext, thing: str, turns: Sequence[float], wanted: Callable[[Array], bool]
) -> list[PointGrasp] | None:
    """Return grasps with which two hands slide a cloth to where `wanted` is true; None if no slide achieves that.

    The cloth may be turned by `turns`, rad. `wanted` gets its points (along y, along x, 3) in `world`, m.
    """
    points, trials = context.world.cloth_points(thing), 0
    rows, columns = points.shape[:2]
    corners = [(0, 0), (0, columns - 1), (rows - 1, columns - 1), (rows - 1, 0)]
    pairs = sorted(itertools.combinations(corners, 2), key=lambda pair: sum(points[corner][0] for corner in pair))
    for slide in _candidate_slides(points, turns):
        if not wanted(slide):
            continue
        for pair in pairs:
            placements = [PointPlacement(corner, target_at_place(slide[corner]), single_layer=True) for corner in pair]
            if (grasps := reachable_grasps(context, thing, placements)) is None:
                continue
            after = predict_cloth_points(context, thing, grasps, 0.0, SLIDE_SPEED)
            if height_range(after) < MAX_SLID_HEIGHT and wanted(after):
                return grasps
            trials += 1
            if trials == _MAX_TRIALS:
                return None
    return None


def _candidate_slides(points: Array, turns: Sequence[float]) -> list[Array]:
    middle = points.reshape(-1, 3).mean(axis=0)
    slides = []
    for nearer, turn in itertools.product(_SLIDE_LENGTHS, turns):
        for lateral in (0.0, -float(middle[1])):
            slides.append((points - middle) @ rotation_z(turn).T + middle + [-nearer, lateral, 0.0])
    return slides
