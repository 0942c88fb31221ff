"""Ways to fold a sheet: which points are laid onto which, and which lie on each other then."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .se3 import Array

Fold = Literal["half", "diagonal", "thirds"]

# Of two layers of a folded sheet, row and column of their points (n, 2): the k-th of each lie on each other.
Layers = tuple[NDArray[np.int_], NDArray[np.int_]]

# Points, by row and column, that are taken at once, each with the point onto which it is laid.
Move = tuple[tuple[tuple[int, int], tuple[int, int]], ...]


@dataclass(frozen=True, eq=False)
class FoldWay:
    """A way to fold a grid of points.

    Attributes:
        moves: what is laid onto what, one after the other.
        layers: which lie on each other then, each time the upper one first, points on a crease left out.
        covered: the share of the flat sheet that it covers then.
    """

    moves: tuple[Move, ...]
    layers: tuple[Layers, ...]
    covered: float


def ways_to_fold(how: Fold, rows: int, columns: int) -> list[FoldWay]:
    """The ways to fold a grid of points: from each side, or from each corner; none if the grid does not allow it.

    `diagonal` takes as many points along both sides. `thirds` takes a side of 3 n + 2 cells: the first third, which
    comes inside, is one cell shorter than the others.
    """
    # From a side, rows are as good as columns; from a corner, both ends of either are.
    aside = how == "diagonal"
    found = []
    for across in (False,) if aside else (False, True):
        size = (columns, rows) if across else (rows, columns)
        if (way := _WAYS[how](*size)) is None:
            continue
        ends = itertools.product((False, True), (False, True) if aside else (False,))
        found += [_seen(way, size, low, left, across) for low, left in ends]
    return found


def _seen(way: FoldWay, size: tuple[int, int], low: bool, left: bool, across: bool) -> FoldWay:
    """The same way from the other end of the rows, or of the columns, or with rows for columns."""

    def points(given: NDArray[np.int_]) -> NDArray[np.int_]:
        rows = size[0] - 1 - given[:, 0] if low else given[:, 0]
        columns = size[1] - 1 - given[:, 1] if left else given[:, 1]
        return np.column_stack([columns, rows] if across else [rows, columns])

    def point(given: tuple[int, int]) -> tuple[int, int]:
        row, column = points(np.array([given]))[0]
        return int(row), int(column)

    moves = tuple(tuple((point(one), point(other)) for one, other in move) for move in way.moves)
    return FoldWay(moves, tuple((points(upper), points(lower)) for upper, lower in way.layers), way.covered)


def _half(rows: int, columns: int) -> FoldWay:
    upper = _grid(range(rows // 2), range(columns))
    return FoldWay((_side_over(rows, columns),), ((upper, _mirrored(upper, rows - 1)),), 1 / 2)


def _diagonal(rows: int, columns: int) -> FoldWay | None:
    if rows != columns:
        return None
    upper = _grid(range(rows), range(rows))
    upper = upper[upper.sum(axis=1) < rows - 1]
    return FoldWay(((((0, 0), (rows - 1, rows - 1)),),), ((upper, rows - 1 - upper[:, ::-1]),), 1 / 2)


def _thirds(rows: int, columns: int) -> FoldWay | None:
    cells = rows - 1
    if cells % 3 != 2:
        return None
    third = math.ceil(cells / 3)
    first = cells - 2 * third
    last = columns - 1
    inside = tuple(((0, column), (2 * first, column)) for column in (0, last))
    over = tuple(((cells, column), (first, column)) for column in (0, last))
    lowest = _grid(range(first), range(columns))
    highest = _grid(range(first + third + 1, rows), range(columns))
    # What the first third lies on has the last one over it.
    under = _mirrored(lowest, 2 * first)
    return FoldWay(
        (inside, over),
        (
            (lowest, under),
            (highest, _mirrored(highest, 2 * (first + third))),
            (_mirrored(under, 2 * (first + third)), lowest),
        ),
        third / cells,
    )


_WAYS = {"half": _half, "diagonal": _diagonal, "thirds": _thirds}


def _side_over(rows: int, columns: int) -> Move:
    """The first row onto the last one."""
    return tuple(((0, column), (rows - 1, column)) for column in (0, columns - 1))


def _grid(rows: range, columns: range) -> NDArray[np.int_]:
    return np.array([(row, column) for row in rows for column in columns])


def _mirrored(points: NDArray[np.int_], both: int) -> NDArray[np.int_]:
    """Points (n, 2) by rows that are `both` less theirs."""
    return np.column_stack([both - points[:, 0], points[:, 1]])


def sheet_area(points: Array) -> float:
    """Area of a sheet of points (rows, columns, 3), folded or not, m2."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]

    def triangle(o: Array, p: Array, q: Array) -> Array:
        area: Array = np.linalg.norm(np.cross(p - o, q - o), axis=-1) / 2
        return area

    # A cell that is folded along one of its diagonals has its area in the two triangles beside that one alone.
    cells = np.maximum(triangle(a, b, c) + triangle(d, b, c), triangle(b, a, d) + triangle(c, a, d))
    return float(cells.sum())


def outline_area(places: Array) -> float:
    """Area of the convex outline around places (n, 2), m2."""
    ordered = places[np.lexsort(places.T[::-1])]
    outline: list[Array] = []
    for points in (ordered, ordered[::-1]):
        side: list[Array] = []
        for place in points:
            while len(side) > 1 and _turn(side[-2], side[-1], place) <= 0:
                side.pop()
            side.append(place)
        outline += side[:-1]
    x, y = np.array(outline).T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
