"""The distance between two surfaces, measured at points of both."""

from __future__ import annotations

import numpy as np

from .se3 import Array
from .stl import Faces

# Points that are compared with the same selection of triangles at once.
_BATCH = 200
# Points are grouped in cells: so many along the longest side of the box around them.
_CELLS = 16


def deviation(surface: tuple[Array, Faces], other: tuple[Array, Faces], limit: float, samples: int) -> float:
    """The largest distance of a point on either surface from the other surface.

    It is measured at points sampled evenly by area, and at as many vertices, or at all if there are fewer. The same
    surfaces give the same points.

    Args:
        surface, other: vertices (n, 3) and triangles (m, 3), in one unit.
        limit: larger distances count as infinite, so that they need not be measured.
        samples: how many points are sampled on each surface.
    """
    rng = np.random.default_rng(0)
    farthest = 0.0
    for here, there in ((surface, other), (other, surface)):
        vertices = rng.permutation(here[0])[:samples]
        points = np.concatenate([points_on(here, samples, rng), vertices])
        farthest = max(farthest, float(distances(points, there, limit).max()))
    return farthest


def points_on(surface: tuple[Array, Faces], count: int, rng: np.random.Generator) -> Array:
    """Points (count, 3) sampled evenly from a surface."""
    vertices, faces = surface
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points: Array = (1 - root) * a[face] + root * (1 - v) * b[face] + root * v * c[face]
    return points


def distances(points: Array, surface: tuple[Array, Faces], limit: float) -> Array:
    """Distance (n,) of each point (n, 3) from a surface; infinity where it is more than `limit`."""
    vertices, faces = surface
    triangles = vertices[faces]
    low, high = triangles.min(axis=1) - limit, triangles.max(axis=1) + limit
    # Points that lie close together are compared only with the triangles near them.
    cell = np.floor((points - points.min(axis=0)) / max(float(np.ptp(points, axis=0).max()) / _CELLS, limit))
    order = np.lexsort(cell.T)
    starts = np.flatnonzero(np.diff(cell[order], axis=0).any(axis=1)) + 1
    found = np.full(len(points), np.inf)
    for group in np.split(order, starts):
        for batch in np.array_split(group, -(-len(group) // _BATCH)):
            here = points[batch]
            near = ((low <= here.max(axis=0)) & (high >= here.min(axis=0))).all(axis=1)
            if near.any():
                found[batch] = np.sqrt(_squared(here[:, None], triangles[near]).min(axis=1))
    found[found > limit] = np.inf
    return found


def _squared(points: Array, triangles: Array) -> Array:
    """Squared distances (n, m) of points (n, 1, 3) from triangles (m, 3, 3): from their plane inside, else an edge."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    length = _dot(normal, normal)
    nearest = np.full((len(points), len(triangles)), np.inf)
    inside = np.broadcast_to(length > 0, nearest.shape).copy()
    for start, end in ((a, b), (b, c), (c, a)):
        edge, towards = end - start, points - start
        inside &= _dot(np.cross(normal, edge), towards) >= 0
        along = np.clip(_dot(towards, edge) / np.maximum(_dot(edge, edge), np.finfo(float).tiny), 0.0, 1.0)
        rest = towards - along[..., None] * edge
        nearest = np.minimum(nearest, _dot(rest, rest))
    height = _dot(points - a, normal) ** 2 / np.where(length > 0, length, 1.0)
    squared: Array = np.where(inside, height, nearest)
    return squared


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.einsum("...i,...i->...", a, b)
    return product
