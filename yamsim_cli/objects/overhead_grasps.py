"""Grasps from above: across the narrowest side of a body, near its middle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .primitives import PointBody

_OVER_TABLE = 0.0235  # m, least height over the table: lower, the lower pad of a leaning hand would touch the table
_UNDER_TOP = 0.010  # m, least depth under the top: higher, a pad would hold only with its edge
_PALM = 0.045  # m, greatest depth under the top: deeper, the palm would touch the top
_OVER_MIDDLE = 0.004  # m, height over the thing's middle, so that the thing hangs steadily
_PAD = 0.008  # m, half the width and height of a pad
_AXES_DEG = range(180)
_ROUND = 60  # degrees, range of equally narrow directions above which an outline counts as round
_LIKE = 0.002  # m, excess over the narrowest width up to which a grasp counts as equally narrow
_DISPLACED = (0.015, -0.015)  # m, displacements of further grasps along the object
_FORCE = 15.0  # N, force of each pad, as on the banana
_TIMES_WEIGHT = 8.0  # least force of each pad, as a multiple of half the weight


def overhead_grasp(body: PointBody, mass: float, foot: float, top: float) -> dict[str, Any]:
    """The `grasp` of an object's config, whatever the opening of the gripper.

    Args:
        body: in the object's frame.
        mass: kg.
        foot, top: heights of the lowest and the highest point over the object's origin, m.
    """
    height = max((foot + top) / 2 + _OVER_MIDDLE, foot + _OVER_TABLE)
    height = max(min(height, top - _UNDER_TOP), top - _PALM)
    centre = (float(body.centre[0]), float(body.centre[1]))
    # Only the slice between the pads matters.
    body = PointBody(body.points[np.abs(body.points[:, 2] - height) <= _PAD], body.step)
    widths = {axis: found for axis in _AXES_DEG if (found := body.width(height, axis, centre, _PAD))}
    least = min(width for width, _ in widths.values())
    best = _middle([axis for axis, (width, _) in widths.items() if width <= least + body.step / 2])
    points = [_point(body, height, best, centre)]
    points += [
        _point(body, height, other, centre)
        for turn in (90, 45, 135)
        if widths.get(other := (best + turn) % 180, (math.inf, 0))[0] <= least + _LIKE
    ]
    along = np.array([-math.sin(math.radians(best)), math.cos(math.radians(best))])
    if len(points) == 1:
        for offset in _DISPLACED:
            at = (centre[0] + float(offset * along[0]), centre[1] + float(offset * along[1]))
            found = body.width(height, best, at, _PAD)
            if found and found[0] <= least + _LIKE:
                points.append(_point(body, height, best, at))
    force = max(_FORCE, _TIMES_WEIGHT * mass * 9.81 / 2)
    return {**points[0], "friction": {"force": round(force, 1), "points": points}}


def _middle(axes: list[int]) -> int:
    """The middle of the first run of consecutive directions, degrees; 0 for a round outline."""
    if len(axes) > _ROUND:
        return 0
    # A run may wrap around at 180 degrees.
    start = next(axis for axis in axes if (axis - 1) % 180 not in axes)
    length = next(k for k in range(180) if (start + k) % 180 not in axes)
    return (start + (length - 1) // 2) % 180


def _point(body: PointBody, height: float, axis: int, at: tuple[float, float]) -> dict[str, Any]:
    found = body.width(height, axis, at, _PAD)
    assert found is not None  # checked by the caller
    width, middle = found
    angle = math.radians(axis)
    position = [at[0] + middle * math.cos(angle), at[1] + middle * math.sin(angle), height]
    return {"position": [round(x, 4) for x in position], "axis_deg": float(axis), "opening": round(width / 2, 4)}
