"""Surfaces that enclose a body: whether they do, and what they enclose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .se3 import Array
from .stl import Faces

# Corners nearer to each other than this share of the surface's length are one.
_SAME = 1e-6


@dataclass(frozen=True)
class Enclosed:
    """What a closed surface encloses: volume (m3), centre (3,) and inertia (3, 3) about it of a density of 1."""

    volume: float
    centre: Array
    tensor: Array


def welded(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """The same surface with equal corners made one, and without triangles that have no area by that."""
    length = float(np.ptp(vertices, axis=0).max()) or 1.0
    keys = np.round(vertices / (length * _SAME)).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    joined = index.reshape(-1)[faces].astype(np.int32)
    whole = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    return vertices[first], joined[whole]


def is_closed(faces: Faces) -> bool:
    """Whether every edge of triangles (m, 3) belongs to two of them, which run along it in opposite ways."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    size = int(faces.max(initial=0)) + 1
    forth, back = np.sort(edges[:, 0] * size + edges[:, 1]), np.sort(edges[:, 1] * size + edges[:, 0])
    return bool(len(edges)) and np.array_equal(forth, back)


def enclosed(vertices: Array, faces: Faces) -> Enclosed:
    """What a closed surface encloses; its volume is negative where its triangles run the other way round.

    Source: the divergence theorem over tetrahedra from the origin; their second moments are those of A. Mirtich, "Fast
    and Accurate Computation of Polyhedral Mass Properties", 1996, in matrix form.
    """
    middle = vertices.mean(axis=0)
    a, b, c = np.moveaxis((vertices - middle)[faces], 1, 0)
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = float(six.sum()) / 6
    if abs(volume) < 1e-18:
        return Enclosed(0.0, middle, np.zeros((3, 3)))
    centre = (six[:, None] * (a + b + c)).sum(axis=0) / 24 / volume
    corners = np.stack([a, b, c], axis=1)
    total = corners.sum(axis=1)
    second = (
        np.einsum("i,ikp,ikq->pq", six, corners, corners) + np.einsum("i,ip,iq->pq", six, total, total)
    ) / 120 - volume * np.outer(centre, centre)
    tensor = np.trace(second) * np.eye(3) - second
    return Enclosed(volume, centre + middle, tensor)


def columns(vertices: Array, faces: Faces, xy: Array) -> list[Array]:
    """Heights, in order, at which upright lines through places (n, 2) go through a surface."""
    found: list[list[float]] = [[] for _ in range(len(xy))]
    order = np.argsort(xy[:, 0], kind="stable")
    xs = xy[order, 0]
    for a, b, c in vertices[faces]:
        low, high = np.searchsorted(xs, [min(a[0], b[0], c[0]), max(a[0], b[0], c[0])])
        if low == high:
            continue
        places = order[low:high]
        d = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(d) < 1e-18:
            continue
        px, py = xy[places, 0] - a[0], xy[places, 1] - a[1]
        u = (px * (c[1] - a[1]) - py * (c[0] - a[0])) / d
        v = (py * (b[0] - a[0]) - px * (b[1] - a[1])) / d
        for place, height in zip(
            places[inside := (u >= 0) & (v >= 0) & (u + v <= 1)],
            (a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]))[inside],
            strict=True,
        ):
            found[place].append(float(height))
    return [np.sort(heights) for heights in found]
