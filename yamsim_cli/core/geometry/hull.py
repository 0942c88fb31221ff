"""The convex hull of points, by so many planes that touch it all round."""

from __future__ import annotations

import math

import numpy as np

from .se3 import Array

_PLANES = 800


def directions(count: int = _PLANES) -> Array:
    """Unit vectors (count, 3), spread evenly over the sphere."""
    k = np.arange(count) + 0.5
    down, round_ = np.arccos(1 - 2 * k / count), np.pi * (1 + math.sqrt(5)) * k
    return np.column_stack([np.cos(round_) * np.sin(down), np.sin(round_) * np.sin(down), np.cos(down)])


def depth_in_hull(points: Array, of: Array) -> Array:
    """How deep points (n, 3) lie under the nearest plane that touches the hull of other points, m; negative outside."""
    normals = np.concatenate([directions(), np.eye(3), -np.eye(3)])
    depth = np.full(len(points), np.inf)
    for some in np.array_split(normals, 20):
        reach = (of @ some.T).max(axis=0)
        np.minimum(depth, (reach - points @ some.T).min(axis=1), out=depth)
    return depth


def spread_points(low: Array, high: Array, count: int) -> Array:
    """Points (count, 3) that fill a block evenly, always the same: multiples of the plastic number's powers.

    Source: M. Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018: the R3 sequence.
    """
    plastic = 1.2207440846057596
    steps = plastic ** -np.arange(1.0, 4.0)
    share = (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0
    points: Array = low + share * (high - low)
    return points
