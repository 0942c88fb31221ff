from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .se3 import Array

Point = tuple[int, int]

_ON_TABLE_LAYERS = 0.8  # layer thicknesses over the lowest point, below which a point lies on the table
_FIT_SCALE = 0.03  # share of the sheet's side, distance from the fit at which the weight of a point is 1/4
_FIT_ROUNDS = 10  # of the reweighted fit

# Shares of the sheet's side.
_MIN_DISPLACEMENT = 0.05  # least displacement of a point that is pulled to its flat position
_MIN_SPACING = 0.15  # between candidate points
_STRAIGHTENING_LENGTH = 0.13  # length of a straightening pull

_HAND_RADIUS = 0.028  # m, radius around a point that a hand with open fingers occupies
_MAX_SURROUNDINGS = 2.2  # layer thicknesses, height of the surroundings over a grasped point
_MAX_GRASP_HEIGHT = 4.5  # layer thicknesses, height of a grasped point over the lowest point

# A point covers another if it is more than this many thicknesses higher and more than this many grid cells away.
_COVERING, _ADJACENT = 0.3, 2

# A point belongs to a ridge if it is higher than this many thicknesses and this share of the sheet's height range.
_RIDGE_LAYERS, _RIDGE_SHARE = 2.0, 0.4

_MAX_STRETCH_RATIO = 1.05  # largest distance of two pulled points, as a share of their distance in the flat sheet
_MAX_POINTS = 3  # for unfolding, and as many beside a ridge for straightening
_ARCH_HEIGHT_RATIO = 0.25  # height of the path of an unfolding pull, as a share of its length
_HEIGHT_SCALE = 0.2  # m, height range that adds as much to the unevenness as a mean displacement of one side length


@dataclass(frozen=True, eq=False)
class ClothPull:
    """A pull of grasped points of a sheet to targets.

    Attributes:
        points: row and column of each grasped point.
        targets: horizontal target (2,) of each point, m.
        arch_ratio: height of the path as a share of its length; 0 for a straight pull.
    """

    points: tuple[Point, ...]
    targets: tuple[Array, ...]
    arch_ratio: float


def fit_flat_places(points: Array, rest: Array, thickness: float) -> Array:
    """Return the horizontal positions (rows, columns, 2) of a flat sheet, m, fitted to the part on the table.

    Args:
        points: (rows, columns, 3), m.
        rest: points (n, 3) of the flat sheet in the sheet's frame, m.
        thickness: m.
    """
    # Either side of the sheet may be up.
    fits = [_fit_side(points, rest * [1.0, side, 1.0], thickness) for side in (1.0, -1.0)]
    return min(fits, key=lambda fitted: float(np.linalg.norm(fitted - points[..., :2], axis=-1).mean()))


def _fit_side(points: Array, rest: Array, thickness: float) -> Array:
    """Fit the flat sheet `rest` with its upper side up, by a planar rigid fit reweighted against outliers."""
    seen, flat = points.reshape(-1, 3)[:, :2], rest[:, :2]
    low = points[..., 2].ravel() - points[..., 2].min()
    weights = (low < _ON_TABLE_LAYERS * thickness).astype(float)
    off = _FIT_SCALE * square_side(rest)
    for _ in range(_FIT_ROUNDS):
        middle, centre = (np.average(at, axis=0, weights=weights) for at in (seen, flat))
        shared = (flat - centre).T @ ((seen - middle) * weights[:, None])
        turn = math.atan2(shared[0, 1] - shared[1, 0], shared[0, 0] + shared[1, 1])
        R = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        fitted = (flat - centre) @ R.T + middle
        away = np.linalg.norm(fitted - seen, axis=1)
        weights = 1.0 / (1.0 + (away / off) ** 2) ** 2
    lain: Array = fitted.reshape(*points.shape[:2], 2)
    return lain


def sheet_unevenness(points: Array, rest: Array, thickness: float) -> float:
    """Return the unevenness, 0 (flat) to about 1, from a sheet's height and its displacement from `fit_flat_places`."""
    away = np.linalg.norm(fit_flat_places(points, rest, thickness) - points[..., :2], axis=-1)
    return (float(away.mean()) / square_side(rest) + height_range(points) / _HEIGHT_SCALE) / 2


def height_range(points: Array) -> float:
    """Return the height of the highest point over the lowest point, m."""
    return float(np.ptp(points[..., 2]))


def max_displacement(points: Array, rest: Array, thickness: float) -> float:
    """Return the largest horizontal distance of a point from its position in the flat sheet, m."""
    return float(np.linalg.norm(fit_flat_places(points, rest, thickness) - points[..., :2], axis=-1).max())


def candidate_pulls(
    points: Array, rest: Array, thickness: float, spacing: float, scale: float = 1.0
) -> Iterator[ClothPull]:
    """Yield pulls at the border of a sheet that may flatten it. `points` to `thickness` are as in `fit_flat_places`.

    Args:
        spacing: larger of the distances between neighbouring points along x and along y, m.
        scale: factor of the length of straightening pulls and of the height limits for grasped points.
    """
    side, rows, columns = square_side(rest), *points.shape[:2]
    fitted = fit_flat_places(points, rest, thickness)
    border = [
        (row, column)
        for row in range(rows)
        for column in range(columns)
        if (row in (0, rows - 1) or column in (0, columns - 1))
        and _is_graspable_point(points, (row, column), spacing, scale * thickness, thickness)
    ]
    # Unfold: pull one or two displaced points to their flat positions.
    off = np.linalg.norm(fitted - points[..., :2], axis=-1)
    wrong = _select_distant_points(points, sorted(border, key=lambda point: -off[point]), side)
    wrong = [point for point in wrong if off[point] > _MIN_DISPLACEMENT * side]
    for count in (1, 2):
        for some in itertools.combinations(wrong, count):
            yield ClothPull(some, tuple(fitted[point] for point in some), _ARCH_HEIGHT_RATIO)
    # Straighten: pull a point beside a ridge away from the ridge, or two corners away from the middle.
    high = points[
        points[..., 2] - points[..., 2].min() > max(_RIDGE_LAYERS * thickness, _RIDGE_SHARE * height_range(points))
    ]
    if len(high):
        ridge = high[:, :2].mean(axis=0)
        beside = sorted(border, key=lambda point: float(np.linalg.norm(points[point][:2] - ridge)))
        for point in _select_distant_points(points, beside, side):
            yield ClothPull((point,), (_outward_target(points[point][:2], ridge, scale * side),), 0.0)
    middle, flat = points.reshape(-1, 3)[:, :2].mean(axis=0), rest.reshape(points.shape)
    corners = [point for point in border if point[0] in (0, rows - 1) and point[1] in (0, columns - 1)]
    for pair in itertools.combinations(corners, 2):
        to = tuple(_outward_target(points[point][:2], middle, scale * side) for point in pair)
        yield ClothPull(
            pair,
            _limit_target_distance(to, _MAX_STRETCH_RATIO * float(np.linalg.norm(flat[pair[0]] - flat[pair[1]]))),
            0.0,
        )


def square_side(rest: Array) -> float:
    """Return the side of a square with the area of a flat sheet of points (n, 3), m."""
    return math.sqrt(float(np.prod(np.ptp(rest[:, :2], axis=0))))


def _is_graspable_point(points: Array, point: Point, spacing: float, high: float, thickness: float) -> bool:
    """Return whether no layer covers a point, and it and its surroundings are not too high in layers of `high` m."""
    place, lowest = points[point], float(points[..., 2].min())
    away = np.linalg.norm(points[..., :2] - place[:2], axis=-1)
    over = points[..., 2] - place[2]
    rows, columns = np.indices(points.shape[:2])
    other = np.maximum(abs(rows - point[0]), abs(columns - point[1])) > _ADJACENT
    covered = (other & (away < spacing) & (over > _COVERING * thickness)).any()
    hemmed = (over[away < _HAND_RADIUS] > _MAX_SURROUNDINGS * high).any()
    return not (covered or hemmed) and float(place[2]) - lowest < _MAX_GRASP_HEIGHT * high


def _select_distant_points(points: Array, ordered: Sequence[Point], side: float) -> list[Point]:
    chosen: list[Point] = []
    for point in ordered:
        if all(np.linalg.norm(points[point] - points[other]) > _MIN_SPACING * side for other in chosen):
            chosen.append(point)
        if len(chosen) == _MAX_POINTS:
            break
    return chosen


def _outward_target(place: Array, other: Array, side: float) -> Array:
    offset = place - other
    return place + _STRAIGHTENING_LENGTH * side * offset / max(float(np.linalg.norm(offset)), 1e-9)


def _limit_target_distance(places: tuple[Array, ...], length: float) -> tuple[Array, ...]:
    one, other = places
    share = max(0.0, 1 - length / max(float(np.linalg.norm(other - one)), 1e-9)) / 2
    return one + share * (other - one), other + share * (one - other)
