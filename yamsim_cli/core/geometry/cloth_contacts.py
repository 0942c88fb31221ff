"""Contacts of cloth.

The pinch frame has its origin between the pads, y along the closing axis, and z along the fingers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .se3 import Array


def mask_between_pads(points: Array, width: float, deep: tuple[float, float]) -> NDArray[np.bool_]:
    """Return whether each point (n, 3), in the pinch frame, m, lies between the closed pads, as (n,).

    Args:
        width: half the extent of the pads along x and along y, m.
        deep: lower and upper end of the pads along z, m.
    """
    inside = np.abs(points[:, :2]).max(axis=1) < width
    found: NDArray[np.bool_] = inside & (points[:, 2] > deep[0]) & (points[:, 2] < deep[1])
    return found


def nearest_point_per_layer(
    points: Array, corners: NDArray[np.int_], lines: Array, deep: tuple[float, float]
) -> NDArray[np.int_]:
    """Return the sorted indices of the points that pads grasp: the nearest point of each layer between the pads.

    Two grasped points per layer would keep it from turning about the pads, as fabric does.

    Args:
        points: (n, 3) of the sheet in the pinch frame, m.
        corners: point indices (k, 3) of the sheet's triangles.
        lines: x and y (m, 2) of lines along z through the pads, m. Each layer that a line crosses is grasped.
        deep: lower and upper end of the pads along z, m.
    """
    flat = points[corners][..., :2]
    found: set[int] = set()
    for line in lines:
        a, b, c = (flat[:, k] - line for k in range(3))
        # Unnormalized barycentric coordinates of the line.
        shares = np.stack([_cross_product_xy(b, c), _cross_product_xy(c, a), _cross_product_xy(a, b)], axis=1)
        whole = shares.sum(axis=1)
        through = np.flatnonzero((shares * whole[:, None] >= 0.0).all(axis=1) & (np.abs(whole) > 0.0))
        z = (shares[through] * points[corners[through], 2]).sum(axis=1) / whole[through]
        own = corners[through[(z > deep[0]) & (z < deep[1])]]
        own = own[~np.isin(own, list(found)).any(axis=1)]
        found |= {int(three[np.argmin(np.linalg.norm(points[three, :2] - line, axis=1))]) for three in own}
    return np.array(sorted(found), dtype=int)


def _cross_product_xy(one: Array, other: Array) -> Array:
    crossed: Array = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return crossed


def count_self_intersections(points: Array, ends: NDArray[np.int_], corners: NDArray[np.int_]) -> int:
    """Count the pairs of an edge (m, 2) and a triangle (k, 3) of a sheet that cross and share no point."""
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
