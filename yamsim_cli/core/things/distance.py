"""Distances of points from an object's primitives."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..config.things.primitives import Box, Capsule, Cylinder, Primitive, Ring, Sphere
from ..geometry.se3 import Array


def signed_distance(parts: Sequence[Primitive], points: Array) -> Array:
    """Distance (n,) of points (n, 3) from the surface of the primitives' union, m; negative inside.

    Inside several primitives at once, it is the depth in the deepest one alone.
    """
    nearest: Array = np.min([_from_one(part, points) for part in parts], axis=0)
    return nearest


def _from_one(part: Primitive, points: Array) -> Array:
    match part:
        case Sphere():
            distance: Array = np.linalg.norm(points - part.centre, axis=1) - part.radius
        case Capsule():
            start, along = np.array(part.start), np.subtract(part.end, part.start)
            share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0, 1)
            distance = np.linalg.norm(points - start - share[:, None] * along, axis=1) - part.radius
        case Cylinder():
            x, y, z = (points - part.centre).T
            distance = _outside_of(np.hypot(x, y) - part.radius, np.abs(z) - part.half_height)
        case Box():
            distance = _outside_of(*(np.abs(_in_box(part, points)) - part.half_size).T)
        case Ring():
            # In the plane of radius and height, a ring is a rectangle below the line from its inner to its outer edge.
            along = np.subtract(part.outer, part.inner)
            length = float(np.linalg.norm(along))
            rest = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]]) - part.inner
            u, v = rest @ along / length, rest @ np.array([-along[1], along[0]]) / length
            distance = _outside_of(
                np.abs(u - length / 2) - length / 2, np.abs(v + part.thickness / 2) - part.thickness / 2
            )
    return distance


def _in_box(part: Box, points: Array) -> Array:
    c, s = math.cos(math.radians(part.yaw_deg)), math.sin(math.radians(part.yaw_deg))
    x, y, z = (points - part.centre).T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def _outside_of(*along: Array) -> Array:
    """Distance from a block, given the distances past its faces along each axis."""
    past = np.array(along)
    distance: Array = np.linalg.norm(np.maximum(past, 0), axis=0) + np.minimum(past.max(axis=0), 0)
    return distance
