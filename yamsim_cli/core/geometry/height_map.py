from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from .loft import Surface
from .se3 import Array
from .stl import Faces


@dataclass(frozen=True)
class HeightMap:
    """A height map of a surface on a square grid.

    Attributes:
        x, y: coordinates of the columns (nx,), (ny,), m.
        top: highest point in each column (nx, ny), m; -inf where a column misses the surface.
    """

    x: Array
    y: Array
    top: Array

    @property
    def cell_size(self) -> float:
        """Distance between neighbouring columns, m."""
        return float(self.x[1] - self.x[0])


def compute_height_map(surface: Surface, cells: int) -> HeightMap:
    """Return the height map of a surface: `cells` columns along its longer side in x or y, with an empty rim."""
    triangles = surface[0][surface[1]]
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    cell = float((high - low)[:2].max()) / cells
    # Shift the grid by odd fractions of a cell, so that no column runs along an edge.
    nx, ny = (int(np.ceil((high - low)[k] / cell)) + 4 for k in (0, 1))
    x = low[0] + cell * (np.arange(nx) - 1.5 + 0.0137)
    y = low[1] + cell * (np.arange(ny) - 1.5 + 0.0171)
    top = np.full((nx, ny), -np.inf)
    first = np.ceil((triangles[:, :, :2].min(axis=1) - [x[0], y[0]]) / cell).astype(int)
    last = np.floor((triangles[:, :, :2].max(axis=1) - [x[0], y[0]]) / cell).astype(int)
    span = np.maximum(last - first + 1, 0)
    counts = span[:, 0] * span[:, 1]
    which = np.repeat(np.arange(len(triangles)), counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    i = first[which, 0] + number // np.maximum(span[which, 1], 1)
    j = first[which, 1] + number % np.maximum(span[which, 1], 1)
    a, b, c = np.moveaxis(triangles[which], 1, 0)
    at = np.column_stack([x[i], y[j]])
    area = _double_area(a, b, c)
    flat = np.abs(area) > 1e-16
    area = np.where(flat, area, 1.0)
    # Barycentric coordinates of the columns.
    u, v = _double_area(at, b, c) / area, _double_area(a, at, c) / area
    w = 1 - u - v
    inside = flat & (u >= 0) & (v >= 0) & (w >= 0)
    z = u * a[:, 2] + v * b[:, 2] + w * c[:, 2]
    np.maximum.at(top, (i[inside], j[inside]), z[inside])
    return HeightMap(x, y, top)


def _double_area(a: Array, b: Array, c: Array) -> Array:
    """Return twice the area (n,) of triangles seen from above, negative for clockwise triangles."""
    twice: Array = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return twice


def water_level(top: Array) -> Array:
    """Return the water level in each column (nx, ny) of a height map filled by rain, m, by priority flood."""
    level = np.full_like(top, np.inf)
    queue: list[tuple[float, int, int]] = []
    nx, ny = top.shape
    for i in range(nx):
        for j in range(ny):
            # Water drains through columns without a surface.
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


def crossings_along_z(vertices: Array, faces: Faces, xy: Array) -> list[Array]:
    """Return the sorted heights, m, at which the vertical line through each position (n, 2) crosses a surface."""
    found: list[list[float]] = [[] for _ in range(len(xy))]
    order = np.argsort(xy[:, 0], kind="stable")
    xs = xy[order, 0]
    for a, b, c in vertices[faces]:
        low, high = np.searchsorted(xs, [min(a[0], b[0], c[0]), max(a[0], b[0], c[0])])
        if low == high:
            continue
        near = order[low:high]
        d = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(d) < 1e-18:
            continue
        px, py = xy[near, 0] - a[0], xy[near, 1] - a[1]
        u = (px * (c[1] - a[1]) - py * (c[0] - a[0])) / d
        v = (py * (b[0] - a[0]) - px * (b[1] - a[1])) / d
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        heights = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
        for place, height in zip(near[inside], heights[inside], strict=True):
            found[place].append(float(height))
    return [np.sort(place) for place in found]
