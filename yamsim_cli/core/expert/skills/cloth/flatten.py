from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.geometry.cloth_flattening import (
    ClothPull,
    Point,
    candidate_pulls,
    height_range,
    max_displacement,
    sheet_unevenness,
    square_side,
)
from yamsim_cli.core.geometry.se3 import Array

from ..common_motions import open_and_park_hands
from ..planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..skill import Skill
from .cloth_motions import carry_points, predict_cloth_points
from .point_grasps import PointGrasp, PointPlacement, reachable_grasps, target_at_place

FLAT_LAYERS = 3.5  # layer thicknesses, largest height of flat cloth
FLAT_DISPLACEMENT = 0.06  # share of the cloth's side, of a point from its flat place

_MAX_PULLS = 6
_PULL_SPEED = 0.15  # m/s
_MIN_IMPROVEMENT = 0.04  # share by which a pull must reduce the unevenness

_RETRY_PULL_FACTOR = 3.0  # factor of pull lengths, height limits and the least improvement, once no ordinary pull helps

_PULL_LENGTH_SHARES = (1.0, 0.7, 0.45)  # of a pull, in the order tried, if hands do not reach all of it

# layer thicknesses: horizontal distances of points at a pulled point's target, and of points that follow it
_TARGET_LAYERS, _FOLLOWING_LAYERS = 4, 6

_MISSED_GRASP_RADIUS = 0.02  # m, around a missed point, within which no further grasp is tried


@dataclass(frozen=True, eq=False)
class _PlannedPull:
    grasps: list[PointGrasp]
    pull: ClothPull
    predicted_unevenness: float


class Flatten(Skill):
    """Flatten cloth by pulls at its border, each with the flattest simulated result."""

    TYPICAL_SECONDS: ClassVar[float] = 7.0
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    HANDLES_CLOTH: ClassVar[bool] = True
    thing: str

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill.run`."""
        thing = roles.object_of(self.thing)
        yield from flatten_cloth(context, thing)
        if not is_flat(context, thing, FLAT_LAYERS, FLAT_DISPLACEMENT):
            high = 1000 * height_range(context.world.cloth_points(thing))
            raise SkillFailedError(
                FailureCause.UNREACHABLE, f"no pull makes the {thing} flatter, which is still {high:.0f} mm high"
            )


def flatten_cloth(
    context: PlanningContext,
    thing: str,
    layers: float = FLAT_LAYERS,
    displacement: float = FLAT_DISPLACEMENT,
    max_pulls: int = _MAX_PULLS,
    missed: list[Array] | None = None,
) -> Iterator[MotionSegment]:
    """Pull a cloth until it lies flat or no pull makes it flatter.

    Flat cloth has at most a height of `layers` thicknesses, and points within `displacement`, a share of the side, of
    their places. No pull grasps near the positions (3,) in `missed`, to which those of pulls without effect are added.
    """
    cloth, missed = context.world.cloth_addresses(thing), [] if missed is None else missed
    miss: SkillFailedError | None = None
    for _ in range(max_pulls):
        if is_flat(context, thing, layers, displacement):
            return
        points = context.world.cloth_points(thing)
        planned = _best_pull(context, thing, missed)
        if planned is None:
            # Hands that are still over the cloth block each other.
            yield from open_and_park_hands(context)
            planned = _best_pull(context, thing, missed, _RETRY_PULL_FACTOR)
        if planned is None:
            break
        before, tried = (
            sheet_unevenness(points, cloth.flat_points, cloth.thickness),
            [points[point] for point in planned.pull.points],
        )
        try:
            yield from carry_points(context, thing, planned.grasps, planned.pull.arch_ratio, _PULL_SPEED)
            miss = None
        except SkillFailedError as error:
            miss = error
            missed += tried
            yield from open_and_park_hands(context)
        if (
            sheet_unevenness(context.world.cloth_points(thing), cloth.flat_points, cloth.thickness)
            > (1 - _MIN_IMPROVEMENT) * before
        ):
            # A pull without effect would be planned again.
            missed += tried
    if miss is not None and not is_flat(context, thing, layers, displacement):
        raise miss


def is_flat(context: PlanningContext, thing: str, layers: float, displacement: float) -> bool:
    """Return whether a cloth is flat; arguments as in `flatten_cloth`."""
    cloth, points = context.world.cloth_addresses(thing), context.world.cloth_points(thing)
    level = height_range(points) + cloth.thickness <= layers * cloth.thickness
    return level and max_displacement(points, cloth.flat_points, cloth.thickness) <= displacement * square_side(
        cloth.flat_points
    )


def _best_pull(
    context: PlanningContext, thing: str, missed: Sequence[Array], scale: float = 1.0
) -> _PlannedPull | None:
    """Return the pull with the flattest simulated result; None if no pull makes the cloth flatter.

    No pull is tried near `missed` points. `scale` is a factor on pull lengths, height limits and the least improvement.
    """
    cloth, points = context.world.cloth_addresses(thing), context.world.cloth_points(thing)
    thickness = cloth.thickness
    best: _PlannedPull | None = None
    for pull in candidate_pulls(points, cloth.flat_points, thickness, cloth.max_point_spacing, scale):
        if any(
            np.linalg.norm(points[point] - place) < _MISSED_GRASP_RADIUS for point in pull.points for place in missed
        ):
            continue
        grasps = next(
            filter(
                None,
                (
                    reachable_grasps(context, thing, _point_placements(points, pull, share, thickness))
                    for share in _PULL_LENGTH_SHARES
                ),
            ),
            None,
        )
        if grasps is None:
            continue
        after = predict_cloth_points(context, thing, grasps, pull.arch_ratio, _PULL_SPEED)
        uneven = sheet_unevenness(after, cloth.flat_points, thickness)
        if best is None or uneven < best.predicted_unevenness:
            best = _PlannedPull(grasps, pull, uneven)
    now, improvement = sheet_unevenness(points, cloth.flat_points, thickness), scale * _MIN_IMPROVEMENT
    return None if best is None or best.predicted_unevenness > (1 - improvement) * now else best


def _point_placements(points: Array, pull: ClothPull, share: float, thickness: float) -> list[PointPlacement]:
    placements = []
    for point, to in zip(pull.points, pull.targets, strict=True):
        place = _resting_position_at(points, point, points[point][:2] + share * (to - points[point][:2]), thickness)
        placements.append(PointPlacement(point, target_at_place(place), single_layer=True))
    return placements


def _resting_position_at(points: Array, point: Point, to: Array, thickness: float) -> Array:
    """Return the position of a point moved to `to` (2,): on the cloth that lies there, or on the table."""
    flat, place = points.reshape(-1, 3), points[point]
    there = np.linalg.norm(flat[:, :2] - to, axis=1) < _TARGET_LAYERS * thickness
    follows = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _FOLLOWING_LAYERS * thickness
    below = flat[there & ~follows, 2]
    # A point is not raised to its target: a higher point comes down by itself.
    high = min(float(below.max()) + thickness, float(place[2])) if len(below) else float(flat[:, 2].min())
    return np.array([*to, high])
