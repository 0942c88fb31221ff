from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .se3 import Array
from .stl import Faces

Surface = tuple[Array, Faces]

_WELD_GRID = 1e-9  # m, grid to which vertices are rounded before equal ones are merged


def loft(loops: Sequence[Array]) -> Surface:
    """Return a closed surface through loops of points (k, 3), m, with a fan of triangles at each end.

    Loops are anticlockwise seen from outside the last one. Equal points of a loop become one vertex. For a hollow body,
    the loops go up the outside and down the inside.
    """
    count = len(loops[0])
    first, last = loops[0].mean(axis=0), loops[-1].mean(axis=0)
    vertices = np.concatenate([first[None], *loops, last[None]])
    around = np.arange(count)
    following = (around + 1) % count
    faces = [np.stack([np.zeros(count, int), 1 + following, 1 + around], axis=1)]
    for k in range(len(loops) - 1):
        faces += _triangle_strip(1 + k * count, 1 + (k + 1) * count, count)
    top = 1 + (len(loops) - 1) * count
    faces.append(np.stack([np.full(count, len(vertices) - 1), top + around, top + following], axis=1))
    return weld_vertices(vertices, np.concatenate(faces))


def loft_closed(loops: Sequence[Array]) -> Surface:
    """Return a closed surface through loops of points (k, 3), m, with the last loop joined to the first."""
    count, size = len(loops), len(loops[0])
    faces = [strip for k in range(count) for strip in _triangle_strip(k * size, (k + 1) % count * size, size)]
    return weld_vertices(np.concatenate(loops), np.concatenate(faces))


def _triangle_strip(low: int, high: int, count: int) -> list[NDArray[np.int_]]:
    """Return the triangles between two loops of `count` points, from the indices `low` and `high`."""
    around = np.arange(count)
    following = (around + 1) % count
    return [
        np.stack([low + around, low + following, high + following], axis=1),
        np.stack([low + around, high + following, high + around], axis=1),
    ]


def weld_vertices(vertices: Array, faces: ArrayLike) -> Surface:
    """Merge vertices that are equal to a nanometre, and remove the triangles that thereby lose a corner."""
    _, kept, index = np.unique(np.round(vertices / _WELD_GRID), axis=0, return_index=True, return_inverse=True)
    whole = index.reshape(-1)[np.asarray(faces)]
    left = (whole != np.roll(whole, 1, axis=1)).all(axis=1)
    return vertices[kept], whole[left].astype(np.int32)


def concatenate_surfaces(surfaces: Iterable[Surface]) -> Surface:
    """Combine several surfaces into one without merging vertices."""
    vertices, faces, count = list[Array](), list[Faces](), 0
    for points, triangles in surfaces:
        vertices.append(points)
        faces.append(triangles + np.int32(count))
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def translate_surface(surface: Surface, by: ArrayLike) -> Surface:
    """Return a surface translated by `by` (3,), m."""
    return surface[0] + np.asarray(by), surface[1]


def revolve(profile: ArrayLike, segments: int, lobes: int = 0, depth: float = 0.0) -> Surface:
    """Return the surface of revolution of a profile about the z axis.

    Args:
        profile: radius and height (n, 2), m, from the axis at the bottom, up the outside, and back to the axis.
        segments: faces around the axis.
        lobes, depth: number of bulges around the axis, and their height as a share of the radius.
    """
    angle = 2 * np.pi * np.arange(segments) / segments
    swell = 1.0 + depth * np.cos(lobes * angle)
    ring = np.stack([swell * np.cos(angle), swell * np.sin(angle)], axis=1)
    return loft([np.column_stack([r * ring, np.full(segments, z)]) for r, z in np.asarray(profile, float)])


def rounded_rectangle(half_x: float, half_y: float, corner: float, z: float, per_corner: int = 6) -> Array:
    """Return a rounded rectangle at height z: points (4 * per_corner, 3), m, anticlockwise seen from above."""
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
    """Return a rod along a path, with rounded ends and a superelliptic cross section.

    Args:
        path: centre line (n, 3), m.
        half_width: of the section along `side`, (n,) or one number, m.
        half_height: of the section, normal to the path and `side`, (n,) or one number, m.
        side: direction (3,); only its component normal to the path is used.
        points: around a section.
    """
    line = np.asarray(path, float)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.asarray(side, float) - along * (along @ np.asarray(side, float))[:, None]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(along, across)
    width, height = (np.broadcast_to(np.asarray(size, float), len(line)) for size in (half_width, half_height))
    angle = 2 * np.pi * np.arange(points) / points
    c, s = np.cos(angle), np.sin(angle)
    # A superellipse of exponent 3 has fuller corners than an ellipse.
    full = 1.0 / (np.abs(c) ** 3 + np.abs(s) ** 3) ** (1 / 3)
    loops = [
        line[k] + width[k] * np.outer(full * c, across[k]) + height[k] * np.outer(full * s, up[k])
        for k in range(len(line))
    ]
    return loft(_rounded_ends(loops, line, along, np.maximum(np.minimum(width, height), 1e-5)))


def _rounded_ends(loops: list[Array], line: Array, along: Array, reach: Array) -> list[Array]:
    first, last = list[Array](), list[Array]()
    for turn in (0.35, 0.7):
        share, step = math.cos(turn * math.pi / 2), math.sin(turn * math.pi / 2)
        first.insert(0, line[0] + share * (loops[0] - line[0]) - step * reach[0] * along[0])
        last.append(line[-1] + share * (loops[-1] - line[-1]) + step * reach[-1] * along[-1])
    return [*first, *loops, *last]


def arc(centre: tuple[float, float], radius: float, start_deg: float, end_deg: float, steps: int = 6) -> Array:
    """Return points (steps, 2) on a circular arc in the plane of radius and height, m."""
    angle = np.radians(np.linspace(start_deg, end_deg, steps))
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def shell_profile(inside: ArrayLike, wall: float) -> Array:
    """Return the profile (2 n + k, 2) of a shell with a round rim, m, for `revolve`.

    `inside` is the radius and height (n, 2) of the inner surface, m, from the axis to the rim.
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
