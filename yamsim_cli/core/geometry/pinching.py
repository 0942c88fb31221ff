"""Which points of a sheet are between two pads that close on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .se3 import Array


def between(points: Array, width: float, deep: tuple[float, float]) -> NDArray[np.bool_]:
    """Which points (n, 3), in the frame of a pinch, are between its pads, which are closed.

    Args:
        width: how far from its z axis they are at most, along x and along y, m.
        deep: from where to where along z, m.
    """
    inside = np.abs(points[:, :2]).max(axis=1) < width
    found: NDArray[np.bool_] = inside & (points[:, 2] > deep[0]) & (points[:, 2] < deep[1])
    return found


def nearest_of_layers(
    points: Array, corners: NDArray[np.int_], lines: Array, deep: tuple[float, float]
) -> NDArray[np.int_]:
    """Of every layer of a sheet that a pinch takes hold of, the point next to it: their numbers, in order.

    A layer that is held where one line goes through is left alone by those after it. It turns about one point, as
    fabric bends beside pads, and would not turn about two that are a cell apart.

    Args:
        points: in the frame of a pinch (n, 3), m.
        corners: the numbers of the points at the corners of each triangle of the sheet (k, 3).
        lines: where lines along z go through the pads (m, 2), m: a layer is held that one of them goes through.
        deep: from where to where along z, m.
    """
    flat = points[corners][..., :2]
    found: set[int] = set()
    for line in lines:
        a, b, c = (flat[:, k] - line for k in range(3))
        # How much of the corner across from each side a line's place is: all of one sign inside.
        shares = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
        whole = shares.sum(axis=1)
        through = np.flatnonzero((shares * whole[:, None] >= 0.0).all(axis=1) & (np.abs(whole) > 0.0))
        z = (shares[through] * points[corners[through], 2]).sum(axis=1) / whole[through]
        own = corners[through[(z > deep[0]) & (z < deep[1])]]
        own = own[~np.isin(own, list(found)).any(axis=1)]
        found |= {int(three[np.argmin(np.linalg.norm(points[three, :2] - line, axis=1))]) for three in own}
    return np.array(sorted(found), dtype=int)


def _cross(one: Array, other: Array) -> Array:
    """Of vectors in a plane (n, 2)."""
    crossed: Array = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return crossed
