"""Which points of a folded sheet lie on each other."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .se3 import Array

Fold = Literal["half", "diagonal"]

# The share of a flat sheet that it covers once it is folded.
COVERED = 0.5

# Of the two layers of a folded sheet, row and column of their points (n, 2): the k-th of each lie on each other.
Layers = tuple[NDArray[np.int_], NDArray[np.int_]]


def ways_to_fold(how: Fold, rows: int, columns: int) -> list[Layers]:
    """The layers of each way in which a grid of points can be folded once, points on the crease left out: in half along
    either side, or along either diagonal, which takes as many points along both sides.
    """
    if how == "diagonal":
        if rows != columns:
            return []
        above = np.argwhere(np.triu(np.ones((rows, rows), bool), 1))
        below = above[:, ::-1]
        return [(above, below), (above * (1, -1) + (0, rows - 1), below * (1, -1) + (0, rows - 1))]
    upper, left = np.mgrid[: rows // 2, :columns], np.mgrid[:rows, : columns // 2]
    return [
        (_pairs(*upper), _pairs(rows - 1 - upper[0], upper[1])),
        (_pairs(*left), _pairs(left[0], columns - 1 - left[1])),
    ]


def _pairs(rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.int_]:
    return np.column_stack([rows.ravel(), columns.ravel()])


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
