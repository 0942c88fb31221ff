"""A skill that flattens crumpled cloth by pulls at the border."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from yamsim_cli.core.config.goals.cast import Cast
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.smoothing import (
    Point,
    Pull,
    candidate_pulls,
    height,
    max_displacement,
    side_of,
    unevenness,
)
from yamsim_cli.core.types import Cause

from ..base import Skill
from ..bench import Bench, Segment, SkillFailedError
from ..moves import recover
from .hands import carry, predicted_points
from .reach import PointGrasp, PointPlacement, at_place, reachable_grasps

FLAT_LAYERS = 3.5  # layers, largest height of cloth that counts as flat
FLAT_DISPLACEMENT = 0.06  # share of the side, largest distance of a point from its place in flat cloth

_MAX_PULLS = 6
_PULL_SPEED = 0.15  # m/s
_MIN_IMPROVEMENT = 0.04  # share by which a pull must reduce the unevenness

_RETRY_SCALE = 3.0  # factor of pull lengths, height limits and the least improvement, once no ordinary pull helps

_PULL_SHARES = (1.0, 0.7, 0.45)  # shares of a pull's path, in order of trial, where hands do not reach the whole

# Layers' thickness, horizontal distances: of points on which a pulled point is placed, and of points that follow it.
_SAME_PLACE, _FOLLOWING = 4, 6

_MISSED_RADIUS = 0.02  # m, around a missed point, within which no further grasp is tried


@dataclass(frozen=True, eq=False)
class _PlannedPull:
    """A pull within reach, with its grasps and the predicted unevenness after it."""

    grasps: list[PointGrasp]
    pull: Pull
    uneven: float


class Flatten(Skill):
    """Flatten cloth by pulls at its border until it lies flat; each is the one with the flattest simulated result.

    Attributes:
        thing: a role, which cloth plays.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = False
    OF_CLOTH: ClassVar[bool] = True
    thing: str

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        yield from flatten_cloth(bench, thing)
        if not _is_flat(bench, thing, FLAT_LAYERS, FLAT_DISPLACEMENT):
            high = 1000 * height(bench.world.points(thing))
            raise SkillFailedError(Cause.UNREACHABLE, f"no pull makes the {thing} flatter, which is {high:.0f} mm high")


def flatten_cloth(
    bench: Bench,
    thing: str,
    layers: float = FLAT_LAYERS,
    displacement: float = FLAT_DISPLACEMENT,
    max_pulls: int = _MAX_PULLS,
) -> Iterator[Segment]:
    """Pull a cloth until it lies flat, no pull makes it flatter, or `max_pulls` have been made.

    Args:
        layers: the largest height that counts as flat, in layers.
        displacement: the largest distance of a point from its place in flat cloth, as a share of the side.

    Raises:
        SkillFailedError: hands missed the points of the last pull.
    """
    cloth, missed = bench.world.cloth(thing), list[Array]()
    miss: SkillFailedError | None = None
    for _ in range(max_pulls):
        if _is_flat(bench, thing, layers, displacement):
            return
        points = bench.world.points(thing)
        planned = _best_pull(bench, thing, missed)
        if planned is None:
            # Hands that are still over the cloth block each other.
            yield from recover(bench)
            planned = _best_pull(bench, thing, missed, _RETRY_SCALE)
        if planned is None:
            break
        before, tried = (
            unevenness(points, cloth.rest, cloth.thickness),
            [points[point] for point in planned.pull.points],
        )
        try:
            yield from carry(bench, thing, planned.grasps, planned.pull.arch, _PULL_SPEED)
            miss = None
        except SkillFailedError as error:
            miss = error
            missed += tried
            yield from recover(bench)
        if unevenness(bench.world.points(thing), cloth.rest, cloth.thickness) > (1 - _MIN_IMPROVEMENT) * before:
            # A pull without effect would be planned again.
            missed += tried
    if miss is not None and not _is_flat(bench, thing, layers, displacement):
        raise miss


def _is_flat(bench: Bench, thing: str, layers: float, displacement: float) -> bool:
    """Whether a cloth lies flat; see `flatten_cloth`."""
    cloth, points = bench.world.cloth(thing), bench.world.points(thing)
    level = height(points) + cloth.thickness <= layers * cloth.thickness
    return level and max_displacement(points, cloth.rest, cloth.thickness) <= displacement * side_of(cloth.rest)


def _best_pull(bench: Bench, thing: str, missed: Sequence[Array], scale: float = 1.0) -> _PlannedPull | None:
    """The pull with the flattest simulated result; None if no pull makes the cloth flatter.

    Args:
        missed: places (3,) of missed points, near which no pull is tried.
        scale: see `candidate_pulls`.
    """
    cloth, points = bench.world.cloth(thing), bench.world.points(thing)
    thickness = cloth.thickness
    best: _PlannedPull | None = None
    for pull in candidate_pulls(points, cloth.rest, thickness, cloth.spacing, scale):
        if any(np.linalg.norm(points[point] - place) < _MISSED_RADIUS for point in pull.points for place in missed):
            continue
        grasps = next(
            filter(
                None,
                (reachable_grasps(bench, thing, _placements(points, pull, share, thickness)) for share in _PULL_SHARES),
            ),
            None,
        )
        if grasps is None:
            continue
        after = predicted_points(bench, thing, grasps, pull.arch, _PULL_SPEED)
        uneven = unevenness(after, cloth.rest, thickness)
        if best is None or uneven < best.uneven:
            best = _PlannedPull(grasps, pull, uneven)
    now, improvement = unevenness(points, cloth.rest, thickness), scale * _MIN_IMPROVEMENT
    return None if best is None or best.uneven > (1 - improvement) * now else best


def _placements(points: Array, pull: Pull, share: float, thickness: float) -> list[PointPlacement]:
    """The points of a pull, each with the target at a share of its path."""
    placements = []
    for point, to in zip(pull.points, pull.to, strict=True):
        place = _on_cloth(points, point, points[point][:2] + share * (to - points[point][:2]), thickness)
        placements.append(PointPlacement(point, at_place(place), alone=True))
    return placements


def _on_cloth(points: Array, point: Point, to: Array, thickness: float) -> Array:
    """The place (3,) of a point moved to `to` (2,), seen from above: on the cloth that stays there, or on the table."""
    flat, place = points.reshape(-1, 3), points[point]
    there = np.linalg.norm(flat[:, :2] - to, axis=1) < _SAME_PLACE * thickness
    follows = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _FOLLOWING * thickness
    below = flat[there & ~follows, 2]
    # A point is not raised to the target: one that is higher already comes down by itself.
    high = min(float(below.max()) + thickness, float(place[2])) if len(below) else float(flat[:, 2].min())
    return np.array([*to, high])
