"""Grasps from above, across the narrowest side of a body and near its middle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .primitives import PointBody

_MIN_TABLE_DISTANCE = 0.0235  # m; closer to the table, the lower pad of a tilted hand would touch it
_MIN_TOP_DEPTH = 0.010  # m, under the top; higher, only the edge of a pad would hold the object
_MAX_TOP_DEPTH = 0.045  # m, under the top; deeper, the palm would touch the top
_MIDDLE_OFFSET = 0.004  # m, height over the object's middle, so that the object hangs stably
_HALF_PAD = 0.008  # m, half the width and height of a pad
_AXES_DEG = range(180)
_ROUND_RANGE = 60  # degrees; an outline with a larger range of equally narrow directions counts as round
_WIDTH_TOLERANCE = 0.002  # m, excess over the least width up to which a grasp counts as equally narrow
_DISPLACEMENTS = (0.015, -0.015)  # m, displacements of further grasps along the object
_MIN_FORCE = 15.0  # N, least force of each pad, as on the banana
_WEIGHT_FACTOR = 8.0  # least force of each pad, as a multiple of half the weight


def overhead_grasp(body: PointBody, mass: float, foot: float, top: float) -> dict[str, Any]:
    """Return the `grasp` of an object's config, for a gripper of any opening.

    Args:
        body: in the object's frame.
        mass: kg.
        foot, top: heights of the lowest and the highest point over the object's origin, m.

    Raises:
        ValueError: the pads would touch no part of the body.
    """
    height = max((foot + top) / 2 + _MIDDLE_OFFSET, foot + _MIN_TABLE_DISTANCE)
    height = max(min(height, top - _MIN_TOP_DEPTH), top - _MAX_TOP_DEPTH)
    centre = (float(body.centre[0]), float(body.centre[1]))
    # Only the slice between the pads matters.
    body = PointBody(body.points[np.abs(body.points[:, 2] - height) <= _HALF_PAD], body.step)
    widths = {axis: found for axis in _AXES_DEG if (found := body.width(height, axis, centre, _HALF_PAD))}
    least = min(width for width, _ in widths.values())
    best = _middle([axis for axis, (width, _) in widths.items() if width <= least + body.step / 2])
    points = [_point(body, height, best, centre)]
    points += [
        _point(body, height, other, centre)
        for turn in (90, 45, 135)
        if widths.get(other := (best + turn) % 180, (math.inf, 0))[0] <= least + _WIDTH_TOLERANCE
    ]
    along = np.array([-math.sin(math.radians(best)), math.cos(math.radians(best))])
    if len(points) == 1:
        for offset in _DISPLACEMENTS:
            at = (centre[0] + float(offset * along[0]), centre[1] + float(offset * along[1]))
            found = body.width(height, best, at, _HALF_PAD)
            if found and found[0] <= least + _WIDTH_TOLERANCE:
                points.append(_point(body, height, best, at))
    force = max(_MIN_FORCE, _WEIGHT_FACTOR * mass * 9.81 / 2)
    return {**points[0], "friction": {"force": round(force, 1), "points": points}}


def _middle(axes: list[int]) -> int:
    """Return the middle of the first run of consecutive directions, degrees; 0 for a round outline."""
    if len(axes) > _ROUND_RANGE:
        return 0
    # A run may wrap around at 180 degrees.
    start = next(axis for axis in axes if (axis - 1) % 180 not in axes)
    length = next(k for k in range(180) if (start + k) % 180 not in axes)
    return (start + (length - 1) // 2) % 180


def _point(body: PointBody, height: float, axis: int, at: tuple[float, float]) -> dict[str, Any]:
    found = body.width(height, axis, at, _HALF_PAD)
    assert found is not None  # checked by the caller
    width, middle = found
    angle = math.radians(axis)
    position = [at[0] + middle * math.cos(angle), at[1] + middle * math.sin(angle), height]
    return {"position": [round(x, 4) for x in position], "axis_deg": float(axis), "opening": round(width / 2, 4)}
