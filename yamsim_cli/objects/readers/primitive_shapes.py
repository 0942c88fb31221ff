"""Convert primitives of SDF, URDF and MJCF files to visual surfaces and collision primitives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.stl import Faces

from .object_parts import Surface, SurfaceMaterial

_CIRCLE_SEGMENTS = 40  # facets around the axis
_AXIS_TOLERANCE = 1e-6  # deviation of a vertical axis's z component from 1


def _revolve_outline(outline: Array, material: SurfaceMaterial) -> Surface:
    """Revolve an outline (n, 2): radius and height, m, from the lowest point upwards."""
    middle = outline[1:-1]
    angle = 2 * np.pi * np.arange(_CIRCLE_SEGMENTS) / _CIRCLE_SEGMENTS
    x, y = (np.outer(middle[:, 0], turn) for turn in (np.cos(angle), np.sin(angle)))
    ring = np.stack([x, y, np.repeat(middle[:, 1:], _CIRCLE_SEGMENTS, axis=1)], axis=-1)
    vertices = np.concatenate([ring.reshape(-1, 3), [[0, 0, outline[0, 1]], [0, 0, outline[-1, 1]]]])
    index = np.arange(len(middle) * _CIRCLE_SEGMENTS).reshape(len(middle), _CIRCLE_SEGMENTS)
    right = np.roll(index, -1, axis=1)
    bottom, top = len(vertices) - 2, len(vertices) - 1
    faces: list[Faces] = [
        np.stack([np.full(_CIRCLE_SEGMENTS, bottom), right[0], index[0]], axis=-1),
        np.stack([np.full(_CIRCLE_SEGMENTS, top), index[-1], right[-1]], axis=-1),
    ]
    for k in range(len(middle) - 1):
        faces += [
            np.stack([index[k], right[k], right[k + 1]], axis=-1),
            np.stack([index[k], right[k + 1], index[k + 1]], axis=-1),
        ]
    return Surface(vertices, np.concatenate(faces).astype(np.int32), material)


def collision_shape(kind: str, size: Array, T: Array) -> Mapping[str, Any] | Surface:
    """Return a primitive at a pose (4, 4) as config data, or as a surface if configs cannot express it.

    Args:
        kind: "box", "cylinder", "capsule", "sphere" or "ellipsoid".
        size: half sizes; radius and half length (cylinder, capsule); radius or radii, m.
    """
    centre = [float(x) for x in T[:3, 3]]
    R = T[:3, :3]
    match kind:
        case "sphere":
            return {"type": "sphere", "centre": centre, "radius": float(size[0])}
        case "capsule":
            along = R[:, 2] * size[1]
            ends = ([float(x) for x in T[:3, 3] - along], [float(x) for x in T[:3, 3] + along])
            return {"type": "capsule", "start": ends[0], "end": ends[1], "radius": float(size[0])}
        case "cylinder" if abs(abs(R[2, 2]) - 1) < _AXIS_TOLERANCE:
            return {"type": "cylinder", "centre": centre, "radius": float(size[0]), "half_height": float(size[1])}
        case "box" if abs(np.abs(R[2]).max() - 1) < _AXIS_TOLERANCE:
            up = int(np.abs(R[2]).argmax())
            first = (up + 1) % 3
            yaw = math.degrees(math.atan2(R[1, first], R[0, first]))
            half = [float(size[k]) for k in (first, (up + 2) % 3, up)]
            return {"type": "box", "centre": centre, "half_size": half, "yaw_deg": round(yaw, 6)}
    return primitive_surface(kind, size, SurfaceMaterial()).transform(T)


def primitive_surface(kind: str, size: Array, material: SurfaceMaterial) -> Surface:
    """Return a centred primitive's surface. Raises `RefusedError` for absurd sizes."""
    if not all(1e-6 <= length <= 1e4 for length in size):
        raise RefusedError("impossible", f"it has a primitive of size {' x '.join(f'{length:g}' for length in size)}")
    match kind:
        case "box":
            return _box_surface(size, material)
        case "cylinder":
            radius, half = (float(length) for length in size)
            return _revolve_outline(np.array([[0, -half], [radius, -half], [radius, half], [0, half]]), material)
        case "capsule":
            radius, half = (float(length) for length in size)
            angle = np.linspace(0, np.pi / 2, _CIRCLE_SEGMENTS // 4 + 1)
            top = np.stack([radius * np.cos(angle), half + radius * np.sin(angle)], axis=1)
            return _revolve_outline(np.concatenate([top[::-1] * [1, -1], top]), material)
        case _:
            angle = np.linspace(-np.pi / 2, np.pi / 2, _CIRCLE_SEGMENTS // 2 + 1)
            unit = _revolve_outline(np.stack([np.cos(angle), np.sin(angle)], axis=1), material)
            return Surface(unit.vertices * size, unit.faces, material)


def _box_surface(half: Array, material: SurfaceMaterial) -> Surface:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))]
    return Surface(signs * half, np.array(faces, np.int32), material)
