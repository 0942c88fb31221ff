"""Closed surfaces of vertices (n, 3), m, and triangles (m, 3), anticlockwise seen from outside."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .se3 import Array
from .stl import Faces

_MERGE_DISTANCE = 1e-6  # of the surface's longest side, within which vertices are merged
_TANGENT_PLANES = 800  # tangent planes that approximate a convex hull


@dataclass(frozen=True)
class UniformMassProperties:
    """Mass properties of a body of density 1 kg/m3.

    Attributes:
        volume: m3; negative if the surface is inside out.
        centre: centre of mass (3,), m.
        inertia: matrix (3, 3) about the centre of mass, kg m2.
    """

    volume: float
    centre: Array
    inertia: Array


def uniform_mass_properties(vertices: Array, faces: Faces) -> UniformMassProperties:
    """Return the mass properties of a closed surface filled with 1 kg/m3; overlapping volumes count twice.

    The method sums over tetrahedra from the mean vertex. Source of their second moments: A. Mirtich, "Fast and Accurate
    Computation of Polyhedral Mass Properties", 1996.
    """
    middle = vertices.mean(axis=0)
    a, b, c = np.moveaxis((vertices - middle)[faces], 1, 0)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    total = float(volume.sum())
    corners = np.stack([a, b, c], axis=1)
    sums = corners.sum(axis=1)
    centre = np.einsum("i,ij->j", volume, sums / 4) / total if total else np.zeros(3)
    products = np.einsum("i,ikj,ikl->jl", volume, corners, corners) + np.einsum("i,ij,il->jl", volume, sums, sums)
    spread = products / 20 - total * np.outer(centre, centre)
    return UniformMassProperties(total, centre + middle, np.trace(spread) * np.eye(3) - spread)


def merge_vertices(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Merge vertices that agree within `_MERGE_DISTANCE`, and remove the triangles that thereby lose a corner."""
    length = float(np.ptp(vertices, axis=0).max()) or 1.0
    keys = np.round(vertices / (length * _MERGE_DISTANCE)).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = index.reshape(-1)[faces].astype(np.int32)
    whole = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    return vertices[first], merged[whole]


def count_open_edges(faces: Faces) -> int:
    """Return the number of directed edges whose opposite edge occurs less or more often; 0 for a closed surface."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    size = int(edges.max()) + 1
    forth, back = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
    directed, counts = np.unique(forth, return_counts=True)
    returned, others = np.unique(back, return_counts=True)
    place = np.minimum(np.searchsorted(returned, directed), len(returned) - 1)
    paired = np.where(returned[place] == directed, others[place], 0)
    return int(np.count_nonzero(paired != counts))


def is_closed(faces: Faces) -> bool:
    """Return whether a surface has triangles and no open edge."""
    return bool(len(faces)) and count_open_edges(faces) == 0


def sphere_directions(count: int = _TANGENT_PLANES) -> Array:
    """Return unit vectors (count, 3) spread evenly over the sphere, on a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    down, round_ = np.arccos(1 - 2 * k / count), np.pi * (1 + math.sqrt(5)) * k
    return np.column_stack([np.cos(round_) * np.sin(down), np.sin(round_) * np.sin(down), np.cos(down)])


def depth_in_hull(points: Array, of: Array) -> Array:
    """Return the depth (n,) of points (n, 3) in the convex hull of the points `of`, m; negative outside."""
    normals = np.concatenate([sphere_directions(), np.eye(3), -np.eye(3)])
    depth = np.full(len(points), np.inf)
    for some in np.array_split(normals, 20):
        reach = (of @ some.T).max(axis=0)
        np.minimum(depth, (reach - points @ some.T).min(axis=1), out=depth)
    return depth


def spread_points(low: Array, high: Array, count: int) -> Array:
    """Return points (count, 3) that fill an axis-aligned box evenly; equal arguments give equal points.

    Source: M. Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018: the R3 sequence.
    """
    plastic = 1.2207440846057596
    steps = plastic ** -np.arange(1.0, 4.0)
    share = (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0
    points: Array = low + share * (high - low)
    return points
