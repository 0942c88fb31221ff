"""Flatten cloth that is crumpled: pull it, at its border, where that makes it flatter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...geometry.se3 import Array
from ...geometry.smoothing import Point, Pull, furthest, height, pulls, side_of, unevenness
from ...goals.cast import Cast
from ...types import Cause
from ..base import Skill
from ..bench import Bench, Segment, SkillFailedError
from ..moves import recover
from .hands import carry, outcome
from .reach import Lay, Taken, at, reached

#: Cloth is flat where it is no more layers high than this, and no point lies farther from where it belongs than this
#: share of its side.
LAYERS, ASIDE = 3.5, 0.06

# So many pulls are made at most, at so many m/s. One has to make the sheet flatter by this share of what it is off.
_PULLS, _SPEED = 6, 0.15
_WORTH = 0.04

# Where no pull helps, hands pull so many times as far, and take what is as high, if it is worth as much more.
_BOLD = 3.0

# What hands do not reach, they do in part: by these shares of the way.
_PART = (1.0, 0.7, 0.45)

# What is so near to a place lies there, and what is so near to a point comes along with it, in layers' thickness.
_THERE, _ALONG = 4, 6

# Where a hand missed, none takes hold again within this, m.
_MISSED = 0.02


@dataclass(frozen=True, eq=False)
class _Found:
    """A pull that hands reach, and how far from flat it would leave the sheet."""

    taken: list[Taken]
    pull: Pull
    uneven: float


class Flatten(Skill):
    """Flatten cloth: of the pulls at its border, the one that is made would leave it the flattest, in a simulation
    beside the real one; and so on until it lies flat.

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
        yield from spread(bench, thing)
        if not _is_flat(bench, thing, LAYERS, ASIDE):
            high = 1000 * height(bench.world.points(thing))
            raise SkillFailedError(Cause.UNREACHABLE, f"no pull makes the {thing} flatter, which is {high:.0f} mm high")


def spread(
    bench: Bench, thing: str, layers: float = LAYERS, aside: float = ASIDE, most: int = _PULLS
) -> Iterator[Segment]:
    """Pull a cloth until it lies flat, or no pull makes it flatter.

    Args:
        layers: how many it is high at most where it counts as flat.
        aside: how far a point of it is from where it belongs then at most, as a share of its side.
        most: so many pulls are made at most.

    Raises:
        SkillFailedError: hands missed the last point that they were to pull.
    """
    cloth, missed = bench.world.cloth(thing), list[Array]()
    miss: SkillFailedError | None = None
    for _ in range(most):
        if _is_flat(bench, thing, layers, aside):
            return
        points = bench.world.points(thing)
        found = _flattest(bench, thing, missed)
        if found is None:
            # Hands that are over the cloth yet are in each other's way.
            yield from recover(bench)
            found = _flattest(bench, thing, missed, _BOLD)
        if found is None:
            break
        before, tried = unevenness(points, cloth.rest, cloth.thickness), [points[point] for point in found.pull.points]
        try:
            yield from carry(bench, thing, found.taken, found.pull.arch, _SPEED)
            miss = None
        except SkillFailedError as error:
            miss = error
            missed += tried
            yield from recover(bench)
        if unevenness(bench.world.points(thing), cloth.rest, cloth.thickness) > (1 - _WORTH) * before:
            # What did not help once would be found again.
            missed += tried
    if miss is not None and not _is_flat(bench, thing, layers, aside):
        raise miss


def _is_flat(bench: Bench, thing: str, layers: float, aside: float) -> bool:
    """Whether a cloth lies flat; see `spread`."""
    cloth, points = bench.world.cloth(thing), bench.world.points(thing)
    level = height(points) + cloth.thickness <= layers * cloth.thickness
    return level and furthest(points, cloth.rest, cloth.thickness) <= aside * side_of(cloth.rest)


def _flattest(bench: Bench, thing: str, missed: Sequence[Array], bold: float = 1.0) -> _Found | None:
    """The pull that would leave a cloth the flattest; None where none makes it flatter. See `pulls`."""
    cloth, points = bench.world.cloth(thing), bench.world.points(thing)
    thickness = cloth.thickness
    best: _Found | None = None
    for pull in pulls(points, cloth.rest, thickness, cloth.spacing, bold):
        if any(np.linalg.norm(points[point] - place) < _MISSED for point in pull.points for place in missed):
            continue
        taken = next(
            filter(None, (reached(bench, thing, _lays(points, pull, share, thickness)) for share in _PART)), None
        )
        if taken is None:
            continue
        after = outcome(bench, thing, taken, pull.arch, _SPEED)
        uneven = unevenness(after, cloth.rest, thickness)
        if best is None or uneven < best.uneven:
            best = _Found(taken, pull, uneven)
    now, worth = unevenness(points, cloth.rest, thickness), bold * _WORTH
    return None if best is None or best.uneven > (1 - worth) * now else best


def _lays(points: Array, pull: Pull, share: float, thickness: float) -> list[Lay]:
    """What hands are to do of a pull: a share of its way."""
    lays = []
    for point, to in zip(pull.points, pull.to, strict=True):
        place = _over(points, point, points[point][:2] + share * (to - points[point][:2]), thickness)
        lays.append(Lay(point, at(place), alone=True))
    return lays


def _over(points: Array, point: Point, to: Array, thickness: float) -> Array:
    """Where a point comes to lie (3,) at a place (2,), seen from above: on the cloth that is there, if any is that does
    not come along.
    """
    flat, place = points.reshape(-1, 3), points[point]
    there = np.linalg.norm(flat[:, :2] - to, axis=1) < _THERE * thickness
    along = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _ALONG * thickness
    below = flat[there & ~along, 2]
    # A point that is higher already comes down by itself.
    high = min(float(below.max()) + thickness, float(place[2])) if len(below) else float(flat[:, 2].min())
    return np.array([*to, high])
