"""Folding as the benchmark asks for it: until the block around a cloth is small enough, seen from above."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject
from kitchenbench.sim.success import FOLD_RATIO_PER_FOLD

from ..core.config.things.cloth import Cloth
from ..core.geometry.se3 import Array
from ..core.geometry.smoothing import Point
from ..core.goals.cast import Cast
from ..core.skills.base import Skill
from ..core.skills.bench import Bench, Segment
from ..core.skills.cloth.flatten import spread
from ..core.skills.cloth.hands import carry
from ..core.skills.cloth.reach import Lay, Taken, at, reached
from ..core.skills.cloth.slide import SPEED, slid
from ..core.skills.errors import SkillFailedError
from ..core.skills.moves import idle, recover
from ..core.types import Cause
from .places import T_in_world

# So much smaller than asked for is surely small enough.
_SURELY = 0.96

# Creases lie so far from a side or a corner, as a share of what is seen of the cloth: half of it at most.
_FIRST, _LAST = 0.15, 0.52
# Lines of points are apart by more than this, seen along the crease, m.
_LINE = 0.008

# A fold has to make the block smaller by this share at least, and there are so many of them at most, and slides before.
_WORTH, _FOLDS = 0.06, 5
_SLIDES = 2
# So many times hands may miss what is to be folded: other points are taken then.
_MISSES = 2

# What has several layers is laid so much farther, as a multiple of their height, and by a share of the way at most: the
# outer ones have the longer way. And so much farther what has one: that takes up a wrinkle.
_TAUT, _FARTHER = 2.0, 0.08
_EVENED = 1.0

# Of hands with cloth, m/s: there are only so many actions. Several layers come apart where they are hurried.
_SPEED, _SLOWLY = 0.2, 0.08

# A first third is less than this of the whole. A cloth is pulled nearer so that it ends before `_FAR`, and begins after
# `_NEAR`, ahead of the arms' bases, m.
_THIRD, _FAR, _NEAR = 0.36, 0.60, 0.16

# Crumpled cloth is spread out until it is no more layers high than this, and no point of it farther from where it
# belongs than this share of its side.
_EVEN, _AMISS = 8.0, 0.2
# There is only time for so many pulls, and for so many more where a slide left it uneven.
_PULLS, _PULLS_AFTER = 4, 2

# About what a layer is high, m.
_LAYER = 0.005

# Points that are as near to a corner, m: the uppermost of them is taken.
_AS_NEAR = 0.006


class FoldSmall(Skill):
    """Fold a cloth, as often as it takes, until the block around it is small enough.

    Attributes:
        thing: a role, which cloth plays.
        area: of the block along the axes of `world`, seen from above, at most, m2.
        thirds: whether its first third is folded over first, and it is pulled nearer then, so that hands reach the
            last one.
        crumpled: whether it is spread out first, and slid to where hands reach what has to be done.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    area: float
    thirds: bool = False
    crumpled: bool = False

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        if self.crumpled:
            yield from spread(bench, thing, _EVEN, _AMISS, _PULLS)
        folds = slides = 0
        missed: list[tuple[Point, ...]] = []
        while folds < _FOLDS:
            points = bench.world.points(thing)
            before = block_area(points)
            if before <= self.area:
                return
            if self.thirds and folds == 1 and (pulled := _nearer(bench, thing)):
                yield from carry(bench, thing, pulled, arch=0.0, speed=_SPEED)
                points = bench.world.points(thing)
            ways = [way for way in self._ordered(points, first=not folds) if way.points not in missed]
            way, taken = _reached(bench, thing, points, ways)
            if self.crumpled and not folds and slides < _SLIDES and not self._surely(way):
                if idle(bench):
                    # Hands that are over the cloth yet are in each other's way.
                    yield from recover(bench)
                    continue
                slide = slid(bench, thing, _turns(points), partial(self._foldable, bench, thing))
                if slide is not None:
                    yield from carry(bench, thing, slide, arch=0.0, speed=SPEED)
                    slides += 1
                    yield from spread(bench, thing, _EVEN, _AMISS, _PULLS_AFTER)
                    continue
            if way is None or taken is None:
                break
            try:
                yield from carry(bench, thing, taken, speed=_SLOWLY if folds and way.layers else _SPEED)
            except SkillFailedError:
                # Begun anew, all of it would be spread out again.
                missed.append(way.points)
                if len(missed) > _MISSES:
                    raise
                yield from recover(bench)
                continue
            folds += 1
        if block_area(bench.world.points(thing)) > self.area:
            raise SkillFailedError(Cause.UNREACHABLE, f"no hands reach what would make the {thing} smaller")

    def _ordered(self, points: Array, first: bool) -> list[Fold]:
        """Ways to fold a cloth. What makes it small enough comes first, then what has few layers, whole sides, and what
        makes it smallest.
        """
        before = block_area(points)
        ways = [way for way in ways_to_fold(points, first) if way.area < (1 - _WORTH) * before]
        if self.thirds and first:
            ways = [way for way in ways if way.share < _THIRD and len(way.corners) > 1]
        return sorted(
            ways, key=lambda way: (not self._surely(way), way.layers, len(way.corners) < 2, way.beneath, way.area)
        )

    def _surely(self, way: Fold | None) -> bool:
        """Whether a way makes it small enough."""
        return way is not None and way.area <= _SURELY * self.area

    def _foldable(self, bench: Bench, thing: str, points: Array) -> bool:
        """Whether hands make a cloth small enough at once if its points are there (along y, along x, 3), m."""
        ways = [way for way in self._ordered(points, first=True) if self._surely(way)]
        return _reached(bench, thing, points, ways) != (None, None)


def _reached(
    bench: Bench, thing: str, points: Array, ways: Sequence[Fold]
) -> tuple[Fold, list[Taken]] | tuple[None, None]:
    """The first way that hands reach of a cloth with points (along y, along x, 3), and how."""
    tried = ((way, reached(bench, thing, way.lays, points)) for way in ways)
    return next(((way, taken) for way, taken in tried if taken), (None, None))


def _turns(points: Array) -> list[float]:
    """By what angles a cloth may be turned so that its block becomes smaller, rad."""
    heading = _heading(points)
    return [-heading, -1.2 * heading, 0.0]


def _nearer(bench: Bench, thing: str) -> list[Taken] | None:
    """How hands pull a cloth nearer, at the side that is nearest; None where it is near, or they do not reach it."""
    points = bench.world.points(thing)
    low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    ends = [_at_corner(points, np.array([low[0], y]))[0] for y in (low[1], high[1])]
    for share in (1.0, 0.75, 0.5):
        way = np.array([share * min(high[0] - _FAR, low[0] - _NEAR), 0.0, 0.0])
        if way[0] <= 0:
            break
        if taken := reached(bench, thing, [Lay(point, at(points[point] - way)) for point in ends]):
            return taken
    return None


@dataclass(frozen=True, eq=False)
class Fold:
    """A way to fold a cloth over a straight crease.

    Attributes:
        corners: the points that are taken, by row and column, and where they are to lie (3,), in `world`, m.
        area: of the block around the cloth afterwards, if all goes well, m2.
        layers: how many more than one are folded over.
        beneath: how many points lie under those that are taken, which hands may miss.
        share: of what is seen of the cloth, across the crease.
    """

    corners: tuple[tuple[Point, Array], ...]
    area: float
    layers: int
    beneath: int
    share: float

    @property
    def points(self) -> tuple[Point, ...]:
        """The points that are taken."""
        return tuple(point for point, _ in self.corners)

    @property
    def lays(self) -> list[Lay]:
        """The same for hands."""
        return [Lay(point, at(to)) for point, to in self.corners]


def block_area(points: Array) -> float:
    """Of the block along the axes of `world` around points (..., 3), seen from above, m2."""
    return float(np.prod(np.ptp(points.reshape(-1, 3)[:, :2], axis=0)))


def ways_to_fold(points: Array, single: bool) -> list[Fold]:
    """The ways to fold a cloth as it lies: each side of it over, or each corner, more or less far.

    Args:
        points: of the cloth (along y, along x, 3), in `world`, m.
        single: whether it has one layer yet, so that it is high only where it is uneven.
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
            found += _creased(points, [corner @ axes for corner in ends], inwards * axes[axis], single)
    for corner in (np.array((x, y)) for x in (low[0], high[0]) for y in (low[1], high[1])):
        inwards = np.sign(low + high - 2 * corner) / math.sqrt(2)
        found += _creased(points, [corner @ axes], inwards @ axes, single)
    return found


def _creased(points: Array, corners: Sequence[Array], normal: Array, single: bool) -> list[Fold]:
    """Folds of corners (2,) over creases with a normal (2,), through lines of points: a sheet bends nowhere else."""
    along = np.sort((points.reshape(-1, 3)[:, :2] - corners[0]) @ normal)
    lines = [float(line.mean()) for line in np.split(along, np.flatnonzero(np.diff(along) > _LINE) + 1)]
    lines = [line for line in lines if 0 < _FIRST * along[-1] < line < _LAST * along[-1]]
    return [_fold(points, corners, normal, line, single) for line in lines]


def _fold(points: Array, corners: Sequence[Array], normal: Array, depth: float, single: bool) -> Fold:
    """What lies less than `depth` (m) from given corners (2,), along the crease's normal (2,), is folded over."""
    flat = points.reshape(-1, 3)
    beyond = depth - (flat[:, :2] - corners[0]) @ normal
    mirrored = flat[:, :2] + 2 * np.maximum(beyond, 0.0)[:, None] * normal
    moves = beyond > 0.0
    # What is folded over comes to lie on the rest with all its layers.
    thick = float(np.ptp(flat[moves, 2])) if moves.any() else 0.0
    top = float(flat[~moves, 2].max() + thick)
    taken, beneath = [], 0
    for corner in corners:
        point, under = _at_corner(points, corner)
        end = mirrored.reshape(*points.shape[:2], 2)[point]
        way = float(np.linalg.norm(end - points[point][:2]))
        farther = min((_EVENED if single else _TAUT) * thick, _FARTHER * way)
        taken.append((point, np.array([*(end + farther * normal), top])))
        beneath += under
    layers = round(thick / _LAYER)
    share = depth / float(((flat[:, :2] - corners[0]) @ normal).max())
    return Fold(tuple(taken), float(np.prod(np.ptp(mirrored, axis=0))), layers, beneath, share)


def _at_corner(points: Array, corner: Array) -> tuple[Point, int]:
    """The uppermost point of a cloth at a corner (2,), by row and column, and how many lie under it."""
    apart = np.linalg.norm(points[..., :2] - corner, axis=-1)
    near = np.argwhere(apart < apart.min() + _AS_NEAR)
    row, column = max(near, key=lambda one: float(points[tuple(one)][2]))
    return (int(row), int(column)), len(near) - 1


def _heading(points: Array) -> float:
    """How a sheet's sides lie, as an angle up to quarter turns, rad: however often it is folded along them."""
    sides = np.concatenate([np.diff(points, axis=k)[..., :2].reshape(-1, 2) for k in (0, 1)])
    whole = (sides[:, 0] + 1j * sides[:, 1]) ** 4
    return float(np.angle((whole / np.maximum(np.abs(whole), 1e-12) ** 0.5).sum()) / 4)


def asked_area(blueprint: SceneBlueprint, item: SceneObject, cloth: Cloth) -> float:
    """How large the block around a cloth may be at the end, by the benchmark's checker, m2."""
    given = blueprint.success_params
    if given.get("baseline") == "nominal":
        asset = ASSETS[item.asset]
        whole = asset.footprint_w_cm * asset.footprint_h_cm / 1e4
    else:
        R = np.abs(T_in_world(item, blueprint)[:2, :2])
        whole = float(np.prod(R @ np.array(cloth.size) + 2 * cloth.radius))
    folds, slack = int(float(given.get("fold_count", 1))), float(given.get("slack", 0.0))
    asked = FOLD_RATIO_PER_FOLD**folds * (1 + slack) * whole
    # The checker counts what the cloth is thick, on all sides.
    side = math.sqrt(asked) - 2 * cloth.radius
    return float(side**2) * 0.98
