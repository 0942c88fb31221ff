"""Folding as the benchmark asks for it: until the block around a cloth is small enough, seen from above."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint
from kitchenbench.sim.success import FOLD_RATIO_PER_FOLD

from ..core.config.cloth import Cloth
from ..core.geometry.se3 import Array
from ..core.goals.cast import Cast
from ..core.skills.base import Skill
from ..core.skills.bench import Bench, Segment
from ..core.skills.cloth_hands import Lay, Taken, carry, reached
from ..core.skills.errors import SkillFailedError
from ..core.types import Cause
from .places import T_in_world

# So much smaller than asked for is surely small enough.
_SURELY = 0.96

# Of a side, so much is folded over; of the way from a corner to the one across from it, so far is that corner laid.
_SIDES = (0.5, 0.45, 0.4, 1 / 3, 0.28, 0.22)
_CORNERS = (1.0, 0.75, 0.5)

# A fold has to make the block smaller by this share at least, and there are so many of them at most.
_WORTH, _FOLDS = 0.06, 5

# Points that are as near to a corner, m: the uppermost of them is taken.
_AS_NEAR = 0.006


class FoldSmall(Skill):
    """Fold a cloth, as often as it takes, until the block around it is small enough.

    Attributes:
        thing: a role, which cloth plays.
        area: of the block along the axes of `world`, seen from above, at most, m2.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    area: float

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        for _ in range(_FOLDS):
            before = block_area(bench.world.points(thing))
            if before <= self.area:
                return
            ways = [way for way in ways_to_fold(bench.world.points(thing)) if way.area < (1 - _WORTH) * before]
            taken = next(filter(None, (self._reached(bench, thing, way) for way in self._ordered(ways))), None)
            if taken is None:
                break
            yield from carry(bench, thing, taken)
        if block_area(bench.world.points(thing)) > self.area:
            raise SkillFailedError(Cause.UNREACHABLE, f"no hands reach what would make the {thing} smaller")

    def _ordered(self, ways: Sequence[Fold]) -> list[Fold]:
        """Whole sides that make it small enough come first, then what makes it smallest."""
        return sorted(ways, key=lambda way: (way.area > _SURELY * self.area, len(way.corners) < 2, way.area))

    def _reached(self, bench: Bench, thing: str, way: Fold) -> list[Taken] | None:
        return reached(bench, thing, way.lays)


@dataclass(frozen=True, eq=False)
class Fold:
    """A way to fold a cloth over a straight crease.

    Attributes:
        corners: the points that are taken, by row and column, and where they are to lie (3,), in `world`, m.
        area: of the block around the cloth afterwards, if all goes well, m2.
    """

    corners: tuple[tuple[tuple[int, int], Array], ...]
    area: float

    @property
    def lays(self) -> list[Lay]:
        """The same for hands."""
        return [Lay(point, lambda points, to=to: to) for point, to in self.corners]  # type: ignore[misc]


def block_area(points: Array) -> float:
    """Of the block along the axes of `world` around points (..., 3), seen from above, m2."""
    return float(np.prod(np.ptp(points.reshape(-1, 3)[:, :2], axis=0)))


def ways_to_fold(points: Array) -> list[Fold]:
    """The ways to fold a cloth as it lies: each side of it over, or each corner, more or less far.

    Args:
        points: of the cloth (along y, along x, 3), in `world`, m.
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
            normal = inwards * axes[axis]
            found += [
                _fold(points, [corner @ axes for corner in ends], normal, share * (high - low)[axis])
                for share in _SIDES
            ]
    for corner in (np.array((x, y)) for x in (low[0], high[0]) for y in (low[1], high[1])):
        across = (low + high - 2 * corner) @ axes
        length = float(np.linalg.norm(across))
        found += [_fold(points, [corner @ axes], across / length, share * length / 2) for share in _CORNERS]
    return found


def _fold(points: Array, corners: Sequence[Array], normal: Array, depth: float) -> Fold:
    """What lies less than `depth` (m) from given corners (2,), along the crease's normal (2,), is folded over."""
    flat = points.reshape(-1, 3)
    beyond = depth - (flat[:, :2] - corners[0]) @ normal
    mirrored = flat[:, :2] + 2 * np.maximum(beyond, 0.0)[:, None] * normal
    taken = []
    for corner in corners:
        apart = np.linalg.norm(flat[:, :2] - corner, axis=1)
        near = np.flatnonzero(apart < apart.min() + _AS_NEAR)
        k = int(near[np.argmax(flat[near, 2])])
        to = np.array([*mirrored[k], flat[k, 2]])
        row, column = divmod(k, points.shape[1])
        taken.append(((row, column), to))
    return Fold(tuple(taken), float(np.prod(np.ptp(mirrored, axis=0))))


def _heading(points: Array) -> float:
    """How a sheet's sides lie, as an angle up to quarter turns, rad: however often it is folded along them."""
    sides = np.concatenate([np.diff(points, axis=k)[..., :2].reshape(-1, 2) for k in (0, 1)])
    whole = (sides[:, 0] + 1j * sides[:, 1]) ** 4
    return float(np.angle((whole / np.maximum(np.abs(whole), 1e-12) ** 0.5).sum()) / 4)


def asked_area(blueprint: SceneBlueprint, name: str, cloth: Cloth) -> float:
    """How large the block around a cloth may be at the end, by the benchmark's checker, m2."""
    item = next(one for one in blueprint.objects if one.name == name)
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
