"""How cloth that does not lie flat is pulled flat: how far it is from that, and which points could be taken where."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .se3 import Array

Point = tuple[int, int]

# A point that is no higher over the lowest one than this lies on the table, as a share of a layer's thickness. Those
# that lie so tell how the sheet lies; ones that are farther off count less, as a share of its side.
_LOW, _OFF = 0.8, 0.03
_ROUNDS = 10

# Distances as shares of a sheet's side: so far off is worth a pull, so far apart are points that are tried, and so far
# goes a pull that straightens.
_WORTH, _APART, _STRAIGHTEN = 0.05, 0.15, 0.13

# Around a point, a hand with open fingers needs so much room, m.
_FOOTPRINT = 0.028

# Points are taken around which nothing is more layers higher than the first, and which are as many as the second high
# at most.
_ABOVE, _LAYERS = 2.2, 4.5

# What lies higher than a point by this share of a layer, and is farther from it in the sheet than so many cells, covers
# it.
_LAYER, _NEXT = 0.3, 2

# What is as many layers high, and as high as this share of the highest point, stands up.
_RIDGE, _UPPER = 2.0, 0.4

# Two points are drawn apart by so much more than they are in the flat sheet at most: it stretches by that much.
_TAUT = 1.05

# So many points are tried of each kind.
_MOST = 3

# What is unfolded goes on an arch so high, as a share of its way.
_ARCH = 0.25

# A sheet that lies by the whole of its side off, and one that stands so high (m), are as bad.
_BADLY = 0.2


@dataclass(frozen=True, eq=False)
class Pull:
    """Points that are taken, by row and column, where they are laid (2,), seen from above, m; and on how high an arch,
    as a share of the way.
    """

    points: tuple[Point, ...]
    to: tuple[Array, ...]
    arch: float


def lying(points: Array, rest: Array, thickness: float) -> Array:
    """Where points (..., 2) would be, seen from above, if all of the sheet lay as the part does that lies on the table.

    Args:
        points: where they are (along y, along x, 3), m.
        rest: the same where the sheet is flat (n, 3), in its own frame.
        thickness: of the sheet, m.
    """
    # It may lie with its other side up.
    fits = [_fitted(points, rest * [1.0, side, 1.0], thickness) for side in (1.0, -1.0)]
    return min(fits, key=lambda fitted: float(np.linalg.norm(fitted - points[..., :2], axis=-1).mean()))


def _fitted(points: Array, rest: Array, thickness: float) -> Array:
    """The same (..., 2) for a sheet that lies with a given side up."""
    seen, flat = points.reshape(-1, 3)[:, :2], rest[:, :2]
    low = points[..., 2].ravel() - points[..., 2].min()
    weights = (low < _LOW * thickness).astype(float)
    off = _OFF * side_of(rest)
    for _ in range(_ROUNDS):
        middle, centre = (np.average(at, axis=0, weights=weights) for at in (seen, flat))
        shared = (flat - centre).T @ ((seen - middle) * weights[:, None])
        turn = math.atan2(shared[0, 1] - shared[1, 0], shared[0, 0] + shared[1, 1])
        R = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        fitted = (flat - centre) @ R.T + middle
        away = np.linalg.norm(fitted - seen, axis=1)
        weights = 1.0 / (1.0 + (away / off) ** 2) ** 2
    lain: Array = fitted.reshape(*points.shape[:2], 2)
    return lain


def unevenness(points: Array, rest: Array, thickness: float) -> float:
    """How far from flat a sheet is: 0 where it is flat, 1 where it is as bad as can be. See `lying`."""
    away = np.linalg.norm(lying(points, rest, thickness) - points[..., :2], axis=-1)
    return (float(away.mean()) / side_of(rest) + height(points) / _BADLY) / 2


def height(points: Array) -> float:
    """How much higher than the lowest point the highest one is, m."""
    return float(np.ptp(points[..., 2]))


def furthest(points: Array, rest: Array, thickness: float) -> float:
    """How far, seen from above, a point is at most from where it would lie, m. See `lying`."""
    return float(np.linalg.norm(lying(points, rest, thickness) - points[..., :2], axis=-1).max())


def pulls(points: Array, rest: Array, thickness: float, spacing: float, bold: float = 1.0) -> Iterator[Pull]:
    """Pulls at the border of a sheet that may make it flatter; see `lying`.

    Args:
        spacing: the larger of the distances between neighbours, m.
        bold: so many times as far what straightens goes, and as high may be, or stand around, what is taken.
    """
    side, rows, columns = side_of(rest), *points.shape[:2]
    fitted = lying(points, rest, thickness)
    border = [
        (row, column)
        for row in range(rows)
        for column in range(columns)
        if (row in (0, rows - 1) or column in (0, columns - 1))
        and _free(points, (row, column), spacing, bold * thickness, thickness)
    ]
    # What is off is brought to where it belongs, one point or two.
    off = np.linalg.norm(fitted - points[..., :2], axis=-1)
    wrong = _spread(points, sorted(border, key=lambda point: -off[point]), side)
    wrong = [point for point in wrong if off[point] > _WORTH * side]
    for count in (1, 2):
        for some in itertools.combinations(wrong, count):
            yield Pull(some, tuple(fitted[point] for point in some), _ARCH)
    # What stands up is straightened: by what lies beside it, away from it, or by two corners, away from the middle.
    high = points[points[..., 2] - points[..., 2].min() > max(_RIDGE * thickness, _UPPER * height(points))]
    if len(high):
        ridge = high[:, :2].mean(axis=0)
        beside = sorted(border, key=lambda point: float(np.linalg.norm(points[point][:2] - ridge)))
        for point in _spread(points, beside, side):
            yield Pull((point,), (_away(points[point][:2], ridge, bold * side),), 0.0)
    middle, flat = points.reshape(-1, 3)[:, :2].mean(axis=0), rest.reshape(points.shape)
    corners = [point for point in border if point[0] in (0, rows - 1) and point[1] in (0, columns - 1)]
    for pair in itertools.combinations(corners, 2):
        to = tuple(_away(points[point][:2], middle, bold * side) for point in pair)
        yield Pull(pair, _no_farther(to, _TAUT * float(np.linalg.norm(flat[pair[0]] - flat[pair[1]]))), 0.0)


def side_of(rest: Array) -> float:
    """The side of a square as large as a sheet, m.

    Args:
        rest: its points where it is flat (n, 3), in its own frame.
    """
    return math.sqrt(float(np.prod(np.ptp(rest[:, :2], axis=0))))


def _free(points: Array, point: Point, spacing: float, high: float, thickness: float) -> bool:
    """Whether a hand can take a point: no layer lies over it, it is not many times as high as `high` (m), and nothing
    around it stands up so much.
    """
    place, lowest = points[point], float(points[..., 2].min())
    away = np.linalg.norm(points[..., :2] - place[:2], axis=-1)
    over = points[..., 2] - place[2]
    rows, columns = np.indices(points.shape[:2])
    other = np.maximum(abs(rows - point[0]), abs(columns - point[1])) > _NEXT
    covered = (other & (away < spacing) & (over > _LAYER * thickness)).any()
    hemmed = (over[away < _FOOTPRINT] > _ABOVE * high).any()
    return not (covered or hemmed) and float(place[2]) - lowest < _LAYERS * high


def _spread(points: Array, ordered: Sequence[Point], side: float) -> list[Point]:
    """The first few points that are not beside one another."""
    chosen: list[Point] = []
    for point in ordered:
        if all(np.linalg.norm(points[point] - points[other]) > _APART * side for other in chosen):
            chosen.append(point)
        if len(chosen) == _MOST:
            break
    return chosen


def _away(place: Array, other: Array, side: float) -> Array:
    """A place (2,) that is farther away from another one."""
    way = place - other
    return place + _STRAIGHTEN * side * way / max(float(np.linalg.norm(way)), 1e-9)


def _no_farther(places: tuple[Array, ...], length: float) -> tuple[Array, ...]:
    """Two places (2,), or nearer ones between them that are so far apart: what is taut is not to be stretched."""
    one, other = places
    share = max(0.0, 1 - length / max(float(np.linalg.norm(other - one)), 1e-9)) / 2
    return one + share * (other - one), other + share * (one - other)
