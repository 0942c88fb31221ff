"""Sheets that pass through themselves: no fabric does, but coarse triangles may."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .se3 import Array


def crossings(points: Array, ends: NDArray[np.int_], corners: NDArray[np.int_]) -> int:
    """How many edges go through triangles with which they share no point.

    Args:
        points: where they are (n, 3), m.
        ends: the numbers of the points at the ends of each edge (m, 2).
        corners: the numbers of the points at the corners of each triangle (k, 3).
    """
    p, q = points[ends[:, 0]], points[ends[:, 1]]
    a, b, c = (points[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    one, other = (np.einsum("tk,etk->et", normal, at[:, None] - a[None]) for at in (p, q))
    shared = (ends[:, :, None, None] == corners[None, None]).any(axis=(1, 3))
    e, t = np.nonzero((one * other < 0) & ~shared)
    hit = p[e] + (one[e, t] / (one[e, t] - other[e, t]))[:, None] * (q[e] - p[e])
    sides = [
        np.einsum("ij,ij->i", np.cross(v[t] - u[t], hit - u[t]), normal[t]) > 0 for u, v in ((a, b), (b, c), (c, a))
    ]
    return int(np.all(sides, axis=0).sum())
