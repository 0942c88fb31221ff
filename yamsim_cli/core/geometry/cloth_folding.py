from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .se3 import Array

ClothFoldKind = Literal["half", "diagonal", "thirds"]

# Rows and columns (n, 2) of the points of two layers of a folded sheet. The k-th points lie on each other.
PointsOfTwoLayers = tuple[NDArray[np.int_], NDArray[np.int_]]

# Points (row, column) that are grasped together, each paired with the point onto which it is placed.
FoldMove = tuple[tuple[tuple[int, int], tuple[int, int]], ...]


@dataclass(frozen=True, eq=False)
class FoldPlan:
    """The moves that fold a sheet, a grid of points, and the resulting layers.

    Attributes:
        layers: pairs of adjacent layers, the upper layer first, without points on creases.
        covered: area of the folded sheet as a share of the flat sheet's area.
    """

    moves: tuple[FoldMove, ...]
    layers: tuple[PointsOfTwoLayers, ...]
    covered: float


def fold_plans(kind: ClothFoldKind, rows: int, columns: int) -> list[FoldPlan]:
    """Return the plans that fold a grid of points by `kind`, one from each side or corner; empty if impossible.

    `diagonal` requires a square grid. `thirds` requires a side of 3 n + 2 cells: the inner third is one cell shorter.
    """
    diagonal = kind == "diagonal"
    found = []
    for transposed in (False,) if diagonal else (False, True):
        size = (columns, rows) if transposed else (rows, columns)
        if (plan := _FOLDS[kind](*size)) is None:
            continue
        ends = itertools.product((False, True), (False, True) if diagonal else (False,))
        found += [_transform_plan(plan, size, low, left, transposed) for low, left in ends]
    return found


def _transform_plan(plan: FoldPlan, size: tuple[int, int], low: bool, left: bool, transposed: bool) -> FoldPlan:
    """Return the fold with its rows reversed (`low`), its columns reversed (`left`), or rows and columns exchanged."""

    def map_points(given: NDArray[np.int_]) -> NDArray[np.int_]:
        rows = size[0] - 1 - given[:, 0] if low else given[:, 0]
        columns = size[1] - 1 - given[:, 1] if left else given[:, 1]
        return np.column_stack([columns, rows] if transposed else [rows, columns])

    def map_point(given: tuple[int, int]) -> tuple[int, int]:
        row, column = map_points(np.array([given]))[0]
        return int(row), int(column)

    moves = tuple(tuple((map_point(one), map_point(other)) for one, other in move) for move in plan.moves)
    return FoldPlan(moves, tuple((map_points(upper), map_points(lower)) for upper, lower in plan.layers), plan.covered)


def _half_fold_plan(rows: int, columns: int) -> FoldPlan:
    upper = _grid_points(range(rows // 2), range(columns))
    first_row_over = tuple(((0, column), (rows - 1, column)) for column in (0, columns - 1))
    return FoldPlan((first_row_over,), ((upper, _mirror_rows(upper, rows - 1)),), 1 / 2)


def _diagonal_fold_plan(rows: int, columns: int) -> FoldPlan | None:
    if rows != columns:
        return None
    upper = _grid_points(range(rows), range(rows))
    upper = upper[upper.sum(axis=1) < rows - 1]
    return FoldPlan(((((0, 0), (rows - 1, rows - 1)),),), ((upper, rows - 1 - upper[:, ::-1]),), 1 / 2)


def _thirds_fold_plan(rows: int, columns: int) -> FoldPlan | None:
    cells = rows - 1
    if cells % 3 != 2:
        return None
    third = math.ceil(cells / 3)
    first = cells - 2 * third
    last = columns - 1
    inside = tuple(((0, column), (2 * first, column)) for column in (0, last))
    over = tuple(((cells, column), (first, column)) for column in (0, last))
    lowest = _grid_points(range(first), range(columns))
    highest = _grid_points(range(first + third + 1, rows), range(columns))
    # Part of the middle third, on which the first third lies and which the last third covers.
    under = _mirror_rows(lowest, 2 * first)
    return FoldPlan(
        (inside, over),
        (
            (lowest, under),
            (highest, _mirror_rows(highest, 2 * (first + third))),
            (_mirror_rows(under, 2 * (first + third)), lowest),
        ),
        third / cells,
    )


_FOLDS = {"half": _half_fold_plan, "diagonal": _diagonal_fold_plan, "thirds": _thirds_fold_plan}


def _grid_points(rows: range, columns: range) -> NDArray[np.int_]:
    return np.array([(row, column) for row in rows for column in columns])


def _mirror_rows(points: NDArray[np.int_], both: int) -> NDArray[np.int_]:
    """Mirror the rows of points (n, 2); each row and its mirror image add up to `both`."""
    return np.column_stack([both - points[:, 0], points[:, 1]])


def sheet_area(points: Array) -> float:
    """Return the area of a sheet of points (rows, columns, 3), folded or not, m2."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]

    def triangle_area(o: Array, p: Array, q: Array) -> Array:
        area: Array = np.linalg.norm(np.cross(p - o, q - o), axis=-1) / 2
        return area

    # A cell that is folded along a diagonal keeps its area only in the triangles beside this diagonal.
    cells = np.maximum(triangle_area(a, b, c) + triangle_area(d, b, c), triangle_area(b, a, d) + triangle_area(c, a, d))
    return float(cells.sum())


def outline_area(places: Array) -> float:
    """Return the area of the convex hull of positions (n, 2), m2, by Andrew's monotone chain."""
    ordered = places[np.lexsort(places.T[::-1])]
    outline: list[Array] = []
    for points in (ordered, ordered[::-1]):
        side: list[Array] = []
        for place in points:
            while len(side) > 1 and _cross_product(side[-2], side[-1], place) <= 0:
                side.pop()
            side.append(place)
        outline += side[:-1]
    x, y = np.array(outline).T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def _cross_product(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
