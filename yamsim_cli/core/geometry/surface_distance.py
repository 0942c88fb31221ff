from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .se3 import Array
from .stl import Faces

_POINTS_PER_BATCH = 200  # points that are compared in one call with the triangles near them
_CELLS_PER_SIDE = 16  # grid cells, by which points are grouped, along the longest side of their bounding box


def hausdorff_distance(surface: tuple[Array, Faces], other: tuple[Array, Faces], limit: float, samples: int) -> float:
    """Return the Hausdorff distance of two surfaces, measured at sampled points and vertices of both.

    Distances above `limit` count as infinite. All calls use the same `samples` points and at most as many vertices.
    """
    rng = np.random.default_rng(0)
    farthest = 0.0
    for here, there in ((surface, other), (other, surface)):
        vertices = rng.permutation(here[0])[:samples]
        points = np.concatenate([sample_surface(here, samples, rng)[0], vertices])
        farthest = max(farthest, float(distances_to_surface(points, there, limit).max()))
    return farthest


def sample_surface(
    surface: tuple[Array, Faces], count: int, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """Sample points (count, 3) from a surface, uniformly by area, and return the triangle (count,) of each point."""
    vertices, faces = surface
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return (1 - root) * a[face] + root * (1 - v) * b[face] + root * v * c[face], face


def distances_to_surface(points: Array, surface: tuple[Array, Faces], limit: float) -> Array:
    """Return the distance (n,) of each point (n, 3) from a surface; infinite above `limit`."""
    vertices, faces = surface
    triangles = vertices[faces]
    low, high = triangles.min(axis=1) - limit, triangles.max(axis=1) + limit
    # Compare the points of a cell only with the triangles near this cell.
    cell = np.floor((points - points.min(axis=0)) / max(float(np.ptp(points, axis=0).max()) / _CELLS_PER_SIDE, limit))
    order = np.lexsort(cell.T)
    starts = np.flatnonzero(np.diff(cell[order], axis=0).any(axis=1)) + 1
    found = np.full(len(points), np.inf)
    for group in np.split(order, starts):
        for batch in np.array_split(group, -(-len(group) // _POINTS_PER_BATCH)):
            here = points[batch]
            near = ((low <= here.max(axis=0)) & (high >= here.min(axis=0))).all(axis=1)
            if near.any():
                found[batch] = np.sqrt(_squared_distances(here[:, None], triangles[near]).min(axis=1))
    found[found > limit] = np.inf
    return found


def _squared_distances(points: Array, triangles: Array) -> Array:
    """Return the squared distance (n, m) of each point (n, 1, 3) from each triangle (m, 3, 3)."""
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
