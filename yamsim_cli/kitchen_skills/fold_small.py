"""Fold cloth until its bounding box, seen from above, is small enough."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from ..core.attempt_data import FailureCause
from ..core.config.goals.cloth_predicates import FoldedSize
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.expert.skills.cloth.cloth_motions import carry_points
from ..core.expert.skills.cloth.flatten import flatten_cloth, is_flat
from ..core.expert.skills.cloth.point_grasps import PointGrasp, PointPlacement, reachable_grasps, target_at_place
from ..core.expert.skills.common_motions import open_and_park_hands, unparked_hands
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import Skill
from ..core.geometry.cloth_flattening import Point, height_range
from ..core.geometry.se3 import Array
from ..core.sim.sim_world import SimWorld
from .pressing import press_point
from .slide_grasps import MAX_SLID_HEIGHT, SLIDE_SPEED, find_slide_grasps

_LIMIT_MARGIN = 0.98  # share of the goal's area that the skill aims at
_AREA_MARGIN = 0.96  # predicted area as a share of the limit on the points' box, at which a fold suffices

_MIN_CREASE, _MAX_CREASE = 0.15, 0.52  # from a side or corner, as shares of the cloth
_MIN_LINE_DISTANCE = 0.008  # m, between lines of points across a crease

_MIN_REDUCTION = 0.06  # share of the area, by a fold
_MAX_FOLDS = 5  # per run of the skill
_MAX_MISSES = 2  # failed grasps, after each of which other points are grasped

# Cloth is laid beyond its target: several layers since outer ones have a longer path, a single one to stretch wrinkles.
_LAYERED_OVERSHOOT = 2.0  # multiple of the folded part's height
_MAX_OVERSHOOT = 0.08  # share of the path
_SINGLE_OVERSHOOT = 1.0  # multiple of the folded part's height

_SPEED = 0.2  # m/s, of hands with cloth: the number of actions is limited
_SLOW_SPEED = 0.08  # m/s; several layers slip at a higher speed

_MAX_FOLDED_SHARE = 0.36  # share of the cloth
_FAR_LIMIT, _NEAR_LIMIT = 0.60, 0.16  # m ahead of the bases, of a pulled cloth's far and near edges

_FLAT_LAYERS = 5.0  # layer thicknesses, largest height of flat cloth
_FLAT_DISPLACEMENT = 0.2  # share of the side, largest distance of a point from its place in flat cloth
_MAX_TURN = math.radians(60)  # rad, of a slide
_MAX_PULLS, _MAX_SLIDES = 4, 2  # of crumpled cloth before the first fold
_MIN_PULL_EFFECT = 0.002  # m, least displacement of a point along an axis that counts as an effect of a pull

_MAX_PRESSES = 2  # on a folded cloth that is too high
# m over the cloth's lowest point, of the pinch frame at the end of a press. The tips are 8 mm lower, on the layers.
_PRESSED_HEIGHT = 0.012

_MIN_LATERAL = 0.5  # least length of a direction out from under a cloth; it is near 1 for sides and near 0 for corners
_LAYER_HEIGHT = 0.005  # m, that counts as one layer
_CORNER_TOLERANCE = (
    0.006  # m; of the points that are hardly farther from a corner than the nearest, the uppermost is grasped
)


class FoldSmall(FoldedSize, Skill):
    """Fold a cloth repeatedly, until its bounding box is small enough.

    Attributes:
        thing: a role that cloth plays.
        area: largest area of the box along the axes of `world`, seen from above, m2.
        share: instead of `area`, the largest area as a share of the box's area at the start of the attempt.
        height: largest height of the box, m; folded cloth that is higher is pressed down, unless `crumpled`.
        thirds: whether the first third is folded first, and the cloth is then pulled nearer for the last third.
        crumpled: whether the cloth is first pulled flat, and slid to where hands reach a sufficient fold.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    HANDS: ClassVar[int] = 2
    HANDLES_CLOTH: ClassVar[bool] = True
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    thirds: bool = False
    crumpled: bool = False

    def largest_area(self, world: SimWorld, thing: str) -> float:
        """Return the largest area of the box around the cloth's points, m2, at which the skill ends.

        The goal's box is larger by half the cloth's thickness on each side. The skill also aims at 2 % less than the
        goal's area.
        """
        required = self.largest_box_area(world, thing)
        side = math.sqrt(required) - world.cloth_addresses(thing).thickness
        return float(side**2) * _LIMIT_MARGIN

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Yield the motions that flatten, slide, fold and press the cloth; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        limit = self.largest_area(context.world, thing)
        goal_area = limit / _LIMIT_MARGIN
        if self.crumpled:
            yield from self._spread(context, thing, limit)
        folds = presses = 0
        missed: list[tuple[Point, ...]] = []
        while folds < _MAX_FOLDS:
            points = context.world.cloth_points(thing)
            low = self._is_low(context.world, thing)
            if bounding_box_area(points) <= (limit if low and not presses else goal_area):
                # Presses do not lower crumpled cloth, whose grid is finer.
                if low or self.crumpled or presses == _MAX_PRESSES:
                    break
                yield from _press_down(context, points)
                presses += 1
                continue
            if self.thirds and folds == 1 and (pulled := _pull_nearer_grasps(context, thing)):
                yield from carry_points(context, thing, pulled, arch=0.0, speed=_SPEED)
                points = context.world.cloth_points(thing)
            candidates = [
                fold for fold in self._sorted_folds(points, limit, first=not folds) if fold.grasped_points not in missed
            ]
            fold, grasps = _first_reachable_fold(context, thing, points, candidates)
            if fold is None or grasps is None:
                break
            try:
                grasps = [_with_forward_retreat(grasp) for grasp in grasps]
                yield from carry_points(context, thing, grasps, speed=_SLOW_SPEED if folds and fold.layers else _SPEED)
            except SkillFailedError:
                missed.append(fold.grasped_points)
                if len(missed) > _MAX_MISSES:
                    raise
                yield from open_and_park_hands(context)
                continue
            folds += 1
        if bounding_box_area(context.world.cloth_points(thing)) > goal_area:
            raise SkillFailedError(
                FailureCause.UNREACHABLE, f"no hands reach points that would make the {thing} smaller"
            )

    def _spread(self, context: PlanningContext, thing: str, limit: float) -> Iterator[MotionSegment]:
        """Pull and slide a crumpled cloth, until it is flat and hands reach a sufficient fold."""
        pulls = slides = 0
        missed: list[Array] = []
        while True:
            points = context.world.cloth_points(thing)
            done_pulling = is_flat(context, thing, _FLAT_LAYERS, _FLAT_DISPLACEMENT) or pulls == _MAX_PULLS
            foldable = self._is_foldable(context, thing, limit, points)
            if done_pulling and foldable:
                return
            if not foldable and slides < _MAX_SLIDES and height_range(points) < MAX_SLID_HEIGHT:
                if unparked_hands(context):
                    # Hands that are still over the cloth block each other.
                    yield from open_and_park_hands(context)
                    continue
                wanted = partial(self._is_foldable, context, thing, limit)
                slide = find_slide_grasps(context, thing, _turns_to_axes(points), wanted)
                if slide is not None:
                    yield from carry_points(context, thing, slide, arch=0.0, speed=SLIDE_SPEED)
                    slides += 1
                    continue
            if done_pulling:
                return
            known = len(missed)
            with suppress(SkillFailedError):  # a hand missed the cloth
                yield from flatten_cloth(context, thing, _FLAT_LAYERS, _FLAT_DISPLACEMENT, 1, missed)
            distance = float(np.abs(context.world.cloth_points(thing) - points).max())
            # No pull was made if the cloth did not move, and no pull missed.
            pulls = pulls + 1 if distance > _MIN_PULL_EFFECT or len(missed) > known else _MAX_PULLS

    def _is_low(self, world: SimWorld, thing: str) -> bool:
        """Whether the bounding box is as low as the goal requires."""
        low, high = world.aabb(thing)
        return float(high[2] - low[2]) <= self.height

    def _sorted_folds(self, points: Array, limit: float, first: bool) -> list[CreaseFold]:
        """Return folds, the best first: by sufficient area, few layers, whole sides, and small area."""
        before = bounding_box_area(points)
        folds = [fold for fold in possible_folds(points, first) if fold.area < (1 - _MIN_REDUCTION) * before]
        if self.thirds and first:
            folds = [fold for fold in folds if fold.folded_share < _MAX_FOLDED_SHARE and len(fold.corners) > 1]

        def fold_rank(fold: CreaseFold) -> tuple[bool, int, bool, int, float]:
            return not _is_sufficient(fold, limit), fold.layers, len(fold.corners) < 2, fold.points_beneath, fold.area

        return sorted(folds, key=fold_rank)

    def _is_foldable(self, context: PlanningContext, thing: str, limit: float, points: Array) -> bool:
        """Whether hands reach a sufficient fold of a cloth with points (along y, along x, 3), m."""
        folds = [fold for fold in self._sorted_folds(points, limit, first=True) if _is_sufficient(fold, limit)]
        return _first_reachable_fold(context, thing, points, folds) != (None, None)


def _press_down(context: PlanningContext, points: Array) -> Iterator[MotionSegment]:
    """Press down the highest point of a folded cloth, such as a crease that stands up."""
    yield from open_and_park_hands(context)  # hands that are still over the cloth block each other
    highest, depth = points.reshape(-1, 3)[points[..., 2].argmax()], height_range(points) - _PRESSED_HEIGHT
    if depth > 0:
        yield from press_point(context, highest, depth)


def _is_sufficient(fold: CreaseFold | None, limit: float) -> bool:
    return fold is not None and fold.area <= _AREA_MARGIN * limit


def _first_reachable_fold(
    context: PlanningContext, thing: str, points: Array, folds: Sequence[CreaseFold]
) -> tuple[CreaseFold, list[PointGrasp]] | tuple[None, None]:
    tried = ((fold, reachable_grasps(context, thing, fold.point_targets, points)) for fold in folds)
    return next(((fold, grasps) for fold, grasps in tried if grasps), (None, None))


def _with_forward_retreat(grasp: PointGrasp) -> PointGrasp:
    """Return a grasp whose hand leaves a corner that is folded alone by moving forward, out from under it.

    `PointGrasp.lateral` has no length then, and a hand that only rises lifts the cloth.
    """
    has_lateral = float(np.linalg.norm(grasp.lateral)) > _MIN_LATERAL
    return grasp if has_lateral else replace(grasp, lateral=grasp.forward)


def _turns_to_axes(points: Array) -> list[float]:
    """Return the turns to try, rad: to the nearest axis, a little beyond it, possibly to the other axis, and none."""
    heading = _sheet_heading(points)
    to_other_axis = math.copysign(math.pi / 2, heading) - heading
    return [-heading, -1.2 * heading, *([to_other_axis] if abs(to_other_axis) < _MAX_TURN else []), 0.0]


def _pull_nearer_grasps(context: PlanningContext, thing: str) -> list[PointGrasp] | None:
    """Return grasps that pull a cloth nearer by its nearest side; None if it is near, or out of reach."""
    points = context.world.cloth_points(thing)
    low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    ends = [_corner_point(points, np.array([low[0], y]))[0] for y in (low[1], high[1])]
    for share in (1.0, 0.75, 0.5):
        shift = np.array([share * min(high[0] - _FAR_LIMIT, low[0] - _NEAR_LIMIT), 0.0, 0.0])
        if shift[0] <= 0:
            break
        if grasps := reachable_grasps(
            context, thing, [PointPlacement(point, target_at_place(points[point] - shift)) for point in ends]
        ):
            return grasps
    return None


@dataclass(frozen=True, eq=False)
class CreaseFold:
    """A fold of a cloth over a straight crease.

    Attributes:
        corners: the grasped points, by row and column, and their targets (3,) in `world`, m.
        area: predicted area of the bounding box after the fold, m2.
        layers: number of folded layers beyond one.
        points_beneath: number of points under the grasped ones, which hands may miss.
        folded_share: folded part of the cloth's length across the crease, 0..1.
    """

    corners: tuple[tuple[Point, Array], ...]
    area: float
    layers: int
    points_beneath: int
    folded_share: float

    @property
    def grasped_points(self) -> tuple[Point, ...]:
        """The grasped points, by row and column."""
        return tuple(point for point, _ in self.corners)

    @property
    def point_targets(self) -> list[PointPlacement]:
        """The grasped points and their targets, for `reachable_grasps`."""
        return [PointPlacement(point, target_at_place(to)) for point, to in self.corners]


def bounding_box_area(points: Array) -> float:
    """Return the area of the box along the axes of `world` around points (..., 3), seen from above, m2."""
    return float(np.prod(np.ptp(points.reshape(-1, 3)[:, :2], axis=0)))


def possible_folds(points: Array, single: bool) -> list[CreaseFold]:
    """Return the folds of each side and corner over creases at several distances.

    `grasped_points` are (along y, along x, 3), in `world`, m. In a `single` layer, only wrinkles are higher.
    """
    heading = _sheet_heading(points)
    axes = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
    along = points.reshape(-1, 3)[:, :2] @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    found = []
    for axis in (0, 1):
        for end, inwards in ((low, 1.0), (high, -1.0)):
            ends = [end.copy(), end.copy()]
            for corner, bound in zip(ends, (low, high), strict=True):
                corner[1 - axis] = bound[1 - axis]
            found += _folds_over_creases(points, [corner @ axes for corner in ends], inwards * axes[axis], single)
    for corner in (np.array((x, y)) for x in (low[0], high[0]) for y in (low[1], high[1])):
        inwards = np.sign(low + high - 2 * corner) / math.sqrt(2)
        found += _folds_over_creases(points, [corner @ axes], inwards @ axes, single)
    return found


def _folds_over_creases(points: Array, corners: Sequence[Array], normal: Array, single: bool) -> list[CreaseFold]:
    """Return folds of corners (2,) over creases with a normal (2,), along lines of points: a sheet bends only there."""
    along = np.sort((points.reshape(-1, 3)[:, :2] - corners[0]) @ normal)
    lines = [float(line.mean()) for line in np.split(along, np.flatnonzero(np.diff(along) > _MIN_LINE_DISTANCE) + 1)]
    lines = [line for line in lines if 0 < _MIN_CREASE * along[-1] < line < _MAX_CREASE * along[-1]]
    return [_make_fold(points, corners, normal, line, single) for line in lines]


def _make_fold(points: Array, corners: Sequence[Array], normal: Array, depth: float, single: bool) -> CreaseFold:
    """Return the fold of the part less than `depth` (m) from given corners (2,), along the crease's normal (2,)."""
    flat = points.reshape(-1, 3)
    beyond = depth - (flat[:, :2] - corners[0]) @ normal
    mirrored = flat[:, :2] + 2 * np.maximum(beyond, 0.0)[:, None] * normal
    moves = beyond > 0.0
    # The folded part comes to lie on the rest with all its layers.
    thick = float(np.ptp(flat[moves, 2])) if moves.any() else 0.0
    top = float(flat[~moves, 2].max() + thick)
    grasped, beneath = [], 0
    for corner in corners:
        point, under = _corner_point(points, corner)
        end = mirrored.reshape(*points.shape[:2], 2)[point]
        length = float(np.linalg.norm(end - points[point][:2]))
        overshoot = min((_SINGLE_OVERSHOOT if single else _LAYERED_OVERSHOOT) * thick, _MAX_OVERSHOOT * length)
        grasped.append((point, np.array([*(end + overshoot * normal), top])))
        beneath += under
    layers = round(thick / _LAYER_HEIGHT)
    share = depth / float(((flat[:, :2] - corners[0]) @ normal).max())
    return CreaseFold(tuple(grasped), float(np.prod(np.ptp(mirrored, axis=0))), layers, beneath, share)


def _corner_point(points: Array, corner: Array) -> tuple[Point, int]:
    """Return row and column of the uppermost point at a corner (2,), and the number of points under it."""
    apart = np.linalg.norm(points[..., :2] - corner, axis=-1)
    near = np.argwhere(apart < apart.min() + _CORNER_TOLERANCE)
    row, column = max(near, key=lambda one: float(points[tuple(one)][2]))
    return (int(row), int(column)), len(near) - 1


def _sheet_heading(points: Array) -> float:
    """Return the angle of a sheet's sides, modulo quarter turns, rad, which folds along the sides keep."""
    sides = np.concatenate([np.diff(points, axis=k)[..., :2].reshape(-1, 2) for k in (0, 1)])
    whole = (sides[:, 0] + 1j * sides[:, 1]) ** 4
    return float(np.angle((whole / np.maximum(np.abs(whole), 1e-12) ** 0.5).sum()) / 4)
