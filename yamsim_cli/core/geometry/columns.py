"""A closed surface seen along z: where each column of a grid goes through it, and what water would stand on it."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from .loft import Surface
from .se3 import Array


@dataclass(frozen=True)
class Columns:
    """A grid of columns along z.

    Attributes:
        x, y: middles of the columns (nx,), (ny,), m.
        top: the highest place of the surface in each (nx, ny), m; -inf where there is none.
    """

    x: Array
    y: Array
    top: Array

    @property
    def cell(self) -> float:
        """How far columns are apart, m."""
        return float(self.x[1] - self.x[0])


def columns(surface: Surface, cells: int) -> Columns:
    """The columns through a surface, `cells` along the longer side of what they cover, and an empty rim around."""
    triangles = surface[0][surface[1]]
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    cell = float((high - low)[:2].max()) / cells
    # Off the middle by an odd share, so that no column runs along an edge.
    nx, ny = (int(np.ceil((high - low)[k] / cell)) + 4 for k in (0, 1))
    x = low[0] + cell * (np.arange(nx) - 1.5 + 0.0137)
    y = low[1] + cell * (np.arange(ny) - 1.5 + 0.0171)
    top = np.full((nx, ny), -np.inf)
    first = np.ceil((triangles[:, :, :2].min(axis=1) - [x[0], y[0]]) / cell).astype(int)
    last = np.floor((triangles[:, :, :2].max(axis=1) - [x[0], y[0]]) / cell).astype(int)
    wide = np.maximum(last - first + 1, 0)
    counts = wide[:, 0] * wide[:, 1]
    which = np.repeat(np.arange(len(triangles)), counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    i = first[which, 0] + number // np.maximum(wide[which, 1], 1)
    j = first[which, 1] + number % np.maximum(wide[which, 1], 1)
    a, b, c = np.moveaxis(triangles[which], 1, 0)
    at = np.column_stack([x[i], y[j]])
    area = _twice(a, b, c)
    flat = np.abs(area) > 1e-16
    area = np.where(flat, area, 1.0)
    # Shares of the corners at the column's place, seen from above.
    u, v = _twice(at, b, c) / area, _twice(a, at, c) / area
    w = 1 - u - v
    inside = flat & (u >= 0) & (v >= 0) & (w >= 0)
    z = u * a[:, 2] + v * b[:, 2] + w * c[:, 2]
    np.maximum.at(top, (i[inside], j[inside]), z[inside])
    return Columns(x, y, top)


def _twice(a: Array, b: Array, c: Array) -> Array:
    """Twice the area (n,) of triangles seen from above, negative where they go round clockwise."""
    twice: Array = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return twice


def water_level(top: Array) -> Array:
    """How high water stands in each column (nx, ny) once it has rained on the surface and what can has run off, m."""
    level = np.full_like(top, np.inf)
    queue: list[tuple[float, int, int]] = []
    nx, ny = top.shape
    for i in range(nx):
        for j in range(ny):
            # Where there is nothing, water runs through.
            if i in (0, nx - 1) or j in (0, ny - 1) or top[i, j] == -np.inf:
                level[i, j] = top[i, j]
                heapq.heappush(queue, (float(top[i, j]), i, j))
    while queue:
        height, i, j = heapq.heappop(queue)
        for near in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= near[0] < nx and 0 <= near[1] < ny and level[near] == np.inf:
                level[near] = max(height, float(top[near]))
                heapq.heappush(queue, (float(level[near]), *near))
    return level
