"""Closed surfaces spanned by loops of points, one after the other: what is turned, drawn out or moulded."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .se3 import Array
from .stl import Faces

Surface = tuple[Array, Faces]

# What is nearer to an axis is on it, m.
_POINT = 1e-9


def loft(loops: Sequence[Array]) -> Surface:
    """A closed surface through loops of points, closed by a fan at either end.

    Args:
        loops: each (k, 3) with the same k, in m, anticlockwise seen from where the first loop's outside is: the
            surface goes out over them, and comes back inside for what is hollow. A loop of equal points is one point.

    Returns:
        Vertices (n, 3) in m and triangles (m, 3), anticlockwise seen from outside.
    """
    count = len(loops[0])
    first, last = loops[0].mean(axis=0), loops[-1].mean(axis=0)
    vertices = np.concatenate([first[None], *loops, last[None]])
    around = np.arange(count)
    beside = (around + 1) % count
    faces = [np.stack([np.zeros(count, int), 1 + beside, 1 + around], axis=1)]
    for k in range(len(loops) - 1):
        low, high = 1 + k * count, 1 + (k + 1) * count
        faces.append(np.stack([low + around, low + beside, high + beside], axis=1))
        faces.append(np.stack([low + around, high + beside, high + around], axis=1))
    top = 1 + (len(loops) - 1) * count
    faces.append(np.stack([np.full(count, len(vertices) - 1), top + around, top + beside], axis=1))
    return welded(vertices, np.concatenate(faces))


def ring(loops: Sequence[Array]) -> Surface:
    """A closed surface through loops of points (k, 3), the last one joined to the first: a tube has no ends."""
    count, size = len(loops), len(loops[0])
    around = np.arange(size)
    beside = (around + 1) % size
    faces = []
    for k in range(count):
        low, high = k * size, (k + 1) % count * size
        faces.append(np.stack([low + around, low + beside, high + beside], axis=1))
        faces.append(np.stack([low + around, high + beside, high + around], axis=1))
    return welded(np.concatenate(loops), np.concatenate(faces))


def welded(vertices: Array, faces: ArrayLike) -> Surface:
    """The surface with equal points made one, and without triangles that lose a corner by that."""
    _, kept, index = np.unique(np.round(vertices / _POINT), axis=0, return_index=True, return_inverse=True)
    whole = index.reshape(-1)[np.asarray(faces)]
    left = (whole != np.roll(whole, 1, axis=1)).all(axis=1)
    return vertices[kept], whole[left].astype(np.int32)


def joined(surfaces: Iterable[Surface]) -> Surface:
    """Several closed surfaces as one, each as it is."""
    vertices, faces, count = list[Array](), list[Faces](), 0
    for points, triangles in surfaces:
        vertices.append(points)
        faces.append(triangles + np.int32(count))
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def moved(surface: Surface, by: ArrayLike, turn: ArrayLike | None = None) -> Surface:
    """The surface turned by a rotation (3, 3), then moved by (3,), m."""
    vertices = surface[0] if turn is None else surface[0] @ np.asarray(turn).T
    return vertices + np.asarray(by), surface[1]


def turned(profile: ArrayLike, segments: int, lobes: int = 0, depth: float = 0.0) -> Surface:
    """What a profile sweeps when it is turned about the z axis.

    Args:
        profile: (n, 2) radius and height, m, from the axis below, up outside, and back to the axis.
        segments: how many faces go round.
        lobes, depth: how many times all around the radius swells, and by which share of it.
    """
    angle = 2 * np.pi * np.arange(segments) / segments
    swell = 1.0 + depth * np.cos(lobes * angle)
    ring = np.stack([swell * np.cos(angle), swell * np.sin(angle)], axis=1)
    return loft([np.column_stack([r * ring, np.full(segments, z)]) for r, z in np.asarray(profile, float)])


def outline(half_x: float, half_y: float, corner: float, z: float, per_corner: int = 6) -> Array:
    """A rectangle with round corners at height z: points (4 * per_corner, 3), m, anticlockwise from above."""
    corner = max(min(corner, half_x, half_y), 0.0)
    angle = np.linspace(0, np.pi / 2, per_corner)
    quarter = corner * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        c, s = (1, 0, -1, 0)[k], (0, 1, 0, -1)[k]
        points.append(quarter @ np.array([[c, s], [-s, c]]) + [sx * (half_x - corner), sy * (half_y - corner)])
    flat = np.concatenate(points)
    return np.column_stack([flat, np.full(len(flat), z)])


def tube(path: ArrayLike, half_width: ArrayLike, half_height: ArrayLike, side: ArrayLike, points: int = 12) -> Surface:
    """A rod along a path, its section an ellipse or a flat bar.

    Args:
        path: (n, 3), m.
        half_width: (n,) or one number, across the path along `side`, m.
        half_height: the same, across both, m.
        side: (3,) the direction that the section's width has, rather across the path.
        points: how many go round a section.
    """
    way = np.asarray(path, float)
    along = np.gradient(way, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.asarray(side, float) - along * (along @ np.asarray(side, float))[:, None]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(along, across)
    width, height = (np.broadcast_to(np.asarray(size, float), len(way)) for size in (half_width, half_height))
    angle = 2 * np.pi * np.arange(points) / points
    c, s = np.cos(angle), np.sin(angle)
    # Between an ellipse and a bar: the corners are fuller than an ellipse's.
    full = 1.0 / (np.abs(c) ** 3 + np.abs(s) ** 3) ** (1 / 3)
    loops = [
        way[k] + width[k] * np.outer(full * c, across[k]) + height[k] * np.outer(full * s, up[k])
        for k in range(len(way))
    ]
    return loft(_rounded_ends(loops, way, along, np.maximum(np.minimum(width, height), 1e-5)))


def _rounded_ends(loops: list[Array], way: Array, along: Array, reach: Array) -> list[Array]:
    """The loops, with a round cap's smaller ones at either end."""
    first, last = list[Array](), list[Array]()
    for turn in (0.35, 0.7):
        share, step = math.cos(turn * math.pi / 2), math.sin(turn * math.pi / 2)
        first.insert(0, way[0] + share * (loops[0] - way[0]) - step * reach[0] * along[0])
        last.append(way[-1] + share * (loops[-1] - way[-1]) + step * reach[-1] * along[-1])
    return [*first, *loops, *last]


def arc(centre: tuple[float, float], radius: float, start_deg: float, end_deg: float, steps: int = 6) -> Array:
    """Points (steps, 2) on a circle's arc in the plane of radius and height, m."""
    angle = np.radians(np.linspace(start_deg, end_deg, steps))
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def thickened(inside: ArrayLike, wall: float) -> Array:
    """A shell's profile (2 n + k, 2): its inside's own, moved out by a wall, over a round rim, and back inside.

    Args:
        inside: (n, 2) radius and height of the inner surface, m, from the axis to the rim.
        wall: how thick the shell is, m.
    """
    inner = np.asarray(inside, float)
    along = np.gradient(inner, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    out = np.stack([along[:, 1], -along[:, 0]], axis=1)
    out[0] = (0.0, -1.0)
    outer = inner + wall * out
    outer[0, 0] = 0.0
    outer[:, 0] = np.maximum(outer[:, 0], 0.0)
    top = (inner[-1] + outer[-1]) / 2
    turn = np.linspace(0, np.pi, 7)[1:-1]
    rim = top + wall / 2 * (np.outer(np.cos(turn), out[-1]) + np.outer(np.sin(turn), along[-1]))
    return np.concatenate([outer, rim, inner[::-1]])
