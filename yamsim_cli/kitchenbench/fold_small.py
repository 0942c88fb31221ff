"""A skill that folds cloth until its bounding box, seen from above, is as small as the benchmark requires."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject
from kitchenbench.sim.success import FOLD_RATIO_PER_FOLD

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.objects.cloth import Cloth
from ..core.expert.skills.cloth.cloth_motions import carry_points
from ..core.expert.skills.cloth.flatten import flatten_cloth
from ..core.expert.skills.cloth.point_grasps import PointGrasp, PointPlacement, reachable_grasps, target_at_place
from ..core.expert.skills.cloth.slide_grasps import SLIDE_SPEED, slide_grasps
from ..core.expert.skills.common_motions import open_and_park_hands, unparked_hands
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import Skill
from ..core.geometry.cloth_flattening import Point
from ..core.geometry.se3 import Array
from .object_poses import T_in_world

_SURELY = 0.96  # share of the required area at which a fold counts as sufficient

_FIRST, _LAST = 0.15, 0.52  # distance of creases from a side or a corner, as a share of the cloth across the crease
_LINE = 0.008  # m, between lines of points along a crease

_MIN_GAIN = 0.06  # share by which a fold must reduce the area
_MAX_FOLDS = 5
_MAX_SLIDES = 2  # of crumpled cloth, before the first fold
_MAX_MISSES = 2  # failed grasps, after each of which other points are grasped

_TAUT = (
    2.0  # times the height of the layers, by which several layers are laid farther: outer layers have the longer path
)
_MAX_FARTHER = 0.08  # share of the path, limit of both
_EVENED = 1.0  # times the height, by which a single layer is laid farther, which takes up a wrinkle

_SPEED = 0.2  # m/s, of hands with cloth: the number of actions is limited
_SLOWLY = 0.08  # m/s, with several layers, which slip at a higher speed

_THIRD = 0.36  # share of the cloth, limit of a first third
_FAR, _NEAR = 0.60, 0.16  # m ahead of the arms' bases, limits of a cloth that is pulled nearer

_EVEN = 8.0  # layers, limit of the height of cloth that is spread out
_AMISS = 0.2  # share of the side, limit of a point's distance from its place in a flat cloth
_PULLS, _PULLS_AFTER = 4, 2  # limits of the pulls that spread the cloth, at first and after a slide

_LAYER = 0.005  # m, height of a layer
_AS_NEAR = 0.006  # m; of the points this near to a corner, the uppermost is grasped


class FoldSmall(Skill):
    """Fold a cloth repeatedly, until the bounding box around it is small enough.

    Attributes:
        thing: a role, of cloth.
        area: limit of the box along the axes of `world`, seen from above, m2.
        thirds: whether the first third is folded first, and the cloth is then pulled nearer for the last third.
        crumpled: whether the cloth is spread out first, and slid to where hands reach a sufficient fold.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    area: float
    thirds: bool = False
    crumpled: bool = False

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill`."""
        thing = roles.object_of(self.thing)
        if self.crumpled:
            yield from flatten_cloth(context, thing, _EVEN, _AMISS, _PULLS)
        folds = slides = 0
        missed: list[tuple[Point, ...]] = []
        while folds < _MAX_FOLDS:
            points = context.world.cloth_points(thing)
            before = bounding_box_area(points)
            if before <= self.area:
                return
            if self.thirds and folds == 1 and (pulled := _pull_nearer_grasps(context, thing)):
                yield from carry_points(context, thing, pulled, arch=0.0, speed=_SPEED)
                points = context.world.cloth_points(thing)
            candidates = [fold for fold in self._ordered(points, first=not folds) if fold.points not in missed]
            fold, grasps = _first_reachable_fold(context, thing, points, candidates)
            if self.crumpled and not folds and slides < _MAX_SLIDES and not self._is_sufficient(fold):
                if unparked_hands(context):
                    # Hands that are still over the cloth block each other.
                    yield from open_and_park_hands(context)
                    continue
                slide = slide_grasps(context, thing, _turns(points), partial(self._foldable, context, thing))
                if slide is not None:
                    yield from carry_points(context, thing, slide, arch=0.0, speed=SLIDE_SPEED)
                    slides += 1
                    yield from flatten_cloth(context, thing, _EVEN, _AMISS, _PULLS_AFTER)
                    continue
            if fold is None or grasps is None:
                break
            try:
                yield from carry_points(context, thing, grasps, speed=_SLOWLY if folds and fold.layers else _SPEED)
            except SkillFailedError:
                # A new run of the skill would spread the cloth out again.
                missed.append(fold.points)
                if len(missed) > _MAX_MISSES:
                    raise
                yield from open_and_park_hands(context)
                continue
            folds += 1
        if bounding_box_area(context.world.cloth_points(thing)) > self.area:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no hands reach what would make the {thing} smaller")

    def _ordered(self, points: Array, first: bool) -> list[CreaseFold]:
        """Folds of a cloth: first sufficient ones, then those with few layers, of whole sides, with a small area."""
        before = bounding_box_area(points)
        folds = [fold for fold in possible_folds(points, first) if fold.area < (1 - _MIN_GAIN) * before]
        if self.thirds and first:
            folds = [fold for fold in folds if fold.share < _THIRD and len(fold.corners) > 1]

        def order(fold: CreaseFold) -> tuple[bool, int, bool, int, float]:
            return not self._is_sufficient(fold), fold.layers, len(fold.corners) < 2, fold.beneath, fold.area

        return sorted(folds, key=order)

    def _is_sufficient(self, fold: CreaseFold | None) -> bool:
        """Whether a fold makes the cloth small enough."""
        return fold is not None and fold.area <= _SURELY * self.area

    def _foldable(self, context: PlanningContext, thing: str, points: Array) -> bool:
        """Whether hands reach a sufficient fold of a cloth with points (along y, along x, 3), m."""
        folds = [fold for fold in self._ordered(points, first=True) if self._is_sufficient(fold)]
        return _first_reachable_fold(context, thing, points, folds) != (None, None)


def _first_reachable_fold(
    context: PlanningContext, thing: str, points: Array, folds: Sequence[CreaseFold]
) -> tuple[CreaseFold, list[PointGrasp]] | tuple[None, None]:
    """The first fold that hands reach, of a cloth with points (along y, along x, 3), and the grasps for it."""
    tried = ((fold, reachable_grasps(context, thing, fold.placements, points)) for fold in folds)
    return next(((fold, grasps) for fold, grasps in tried if grasps), (None, None))


def _turns(points: Array) -> list[float]:
    """Angles by which a cloth may be turned so that its bounding box shrinks, rad."""
    heading = _heading(points)
    return [-heading, -1.2 * heading, 0.0]


def _pull_nearer_grasps(context: PlanningContext, thing: str) -> list[PointGrasp] | None:
    """Grasps with which hands pull a cloth nearer by its nearest side; None if it is near, or out of reach."""
    points = context.world.cloth_points(thing)
    low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    ends = [_at_corner(points, np.array([low[0], y]))[0] for y in (low[1], high[1])]
    for share in (1.0, 0.75, 0.5):
        shift = np.array([share * min(high[0] - _FAR, low[0] - _NEAR), 0.0, 0.0])
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
        corners: the grasped points, by row and column, and their target positions (3,) in `world`, m.
        area: expected area of the bounding box after the fold, m2.
        layers: number of folded layers beyond one.
        beneath: number of points under the grasped ones, which hands may miss.
        share: folded part of the cloth, across the crease.
    """

    corners: tuple[tuple[Point, Array], ...]
    area: float
    layers: int
    beneath: int
    share: float

    @property
    def points(self) -> tuple[Point, ...]:
        """The grasped points."""
        return tuple(point for point, _ in self.corners)

    @property
    def placements(self) -> list[PointPlacement]:
        """The grasped points and their targets, for `reachable_grasps`."""
        return [PointPlacement(point, target_at_place(to)) for point, to in self.corners]


def bounding_box_area(points: Array) -> float:
    """Area of the box along the axes of `world` around points (..., 3), seen from above, m2."""
    return float(np.prod(np.ptp(points.reshape(-1, 3)[:, :2], axis=0)))


def possible_folds(points: Array, single: bool) -> list[CreaseFold]:
    """The possible folds of a cloth: of each side or corner, over creases at several distances.

    Args:
        points: of the cloth (along y, along x, 3), in `world`, m.
        single: whether the cloth has a single layer, so that only wrinkles are higher.
    """
    turned = _heading(points)
    axes = np.array([[math.cos(turned), math.sin(turned)], [-math.sin(turned), math.cos(turned)]])
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
    """Folds of corners (2,) over creases with a normal (2,), through lines of points, where alone a sheet bends."""
    along = np.sort((points.reshape(-1, 3)[:, :2] - corners[0]) @ normal)
    lines = [float(line.mean()) for line in np.split(along, np.flatnonzero(np.diff(along) > _LINE) + 1)]
    lines = [line for line in lines if 0 < _FIRST * along[-1] < line < _LAST * along[-1]]
    return [_fold(points, corners, normal, line, single) for line in lines]


def _fold(points: Array, corners: Sequence[Array], normal: Array, depth: float, single: bool) -> CreaseFold:
    """The fold of the part less than `depth` (m) from given corners (2,), along the crease's normal (2,)."""
    flat = points.reshape(-1, 3)
    beyond = depth - (flat[:, :2] - corners[0]) @ normal
    mirrored = flat[:, :2] + 2 * np.maximum(beyond, 0.0)[:, None] * normal
    moves = beyond > 0.0
    # The folded part comes to lie on the rest with all its layers.
    thick = float(np.ptp(flat[moves, 2])) if moves.any() else 0.0
    top = float(flat[~moves, 2].max() + thick)
    grasped, beneath = [], 0
    for corner in corners:
        point, under = _at_corner(points, corner)
        end = mirrored.reshape(*points.shape[:2], 2)[point]
        length = float(np.linalg.norm(end - points[point][:2]))
        farther = min((_EVENED if single else _TAUT) * thick, _MAX_FARTHER * length)
        grasped.append((point, np.array([*(end + farther * normal), top])))
        beneath += under
    layers = round(thick / _LAYER)
    share = depth / float(((flat[:, :2] - corners[0]) @ normal).max())
    return CreaseFold(tuple(grasped), float(np.prod(np.ptp(mirrored, axis=0))), layers, beneath, share)


def _at_corner(points: Array, corner: Array) -> tuple[Point, int]:
    """The uppermost point of a cloth at a corner (2,), by row and column, and the number of points under it."""
    apart = np.linalg.norm(points[..., :2] - corner, axis=-1)
    near = np.argwhere(apart < apart.min() + _AS_NEAR)
    row, column = max(near, key=lambda one: float(points[tuple(one)][2]))
    return (int(row), int(column)), len(near) - 1


def _heading(points: Array) -> float:
    """The angle of a sheet's sides, modulo quarter turns, rad; folds along the sides do not change it."""
    sides = np.concatenate([np.diff(points, axis=k)[..., :2].reshape(-1, 2) for k in (0, 1)])
    whole = (sides[:, 0] + 1j * sides[:, 1]) ** 4
    return float(np.angle((whole / np.maximum(np.abs(whole), 1e-12) ** 0.5).sum()) / 4)


def required_area(blueprint: SceneBlueprint, item: SceneObject, cloth: Cloth) -> float:
    """The largest bounding box of a folded cloth that the benchmark's checker accepts, m2."""
    given = blueprint.success_params
    if given.get("baseline") == "nominal":
        asset = ASSETS[item.asset]
        whole = asset.footprint_w_cm * asset.footprint_h_cm / 1e4
    else:
        R = np.abs(T_in_world(item, blueprint)[:2, :2])
        whole = float(np.prod(R @ np.array(cloth.size) + 2 * cloth.radius))
    folds, slack = int(float(given.get("fold_count", 1))), float(given.get("slack", 0.0))
    required = FOLD_RATIO_PER_FOLD**folds * (1 + slack) * whole
    # The checker includes the cloth's thickness, on all sides.
    side = math.sqrt(required) - 2 * cloth.radius
    return float(side**2) * 0.98
