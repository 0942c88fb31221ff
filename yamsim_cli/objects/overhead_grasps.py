"""Compute grasps from above, across an object's narrowest side near its middle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .primitives import PointBody

_MIN_TABLE_DISTANCE = 0.0235  # m, pads' middle over the table; lower, a tilted hand would touch it
_MIN_TOP_DEPTH = 0.010  # m, pads' middle under the top; higher, only their edges would hold
_MAX_TOP_DEPTH = 0.045  # m, pads' middle under the top; deeper, the palm would touch it
_HEIGHT_OVER_MIDDLE = 0.004  # m, pads over half the object's height, so that it hangs stably
_HALF_PAD = 0.008  # m, half width and height
_AXES_DEG = range(180)  # degrees
_MIN_ROUND_HEADINGS = 60  # headings (1 degree apart) of nearly the least width, above which an outline is round
_WIDTH_TOLERANCE = 0.002  # m over the least width, of further grasp points
_GRASP_POINT_SHIFTS = (0.015, -0.015)  # m, of further grasp points along an object with one narrow heading
_MIN_FORCE = 15.0  # N, of each pad, as in the banana's config
_WEIGHT_FACTOR = 8.0  # each pad's force over half the weight


def overhead_grasp(body: PointBody, mass: float, foot: float, top: float) -> dict[str, Any]:
    """Return a config's `grasp` of an object, which may be wider than a gripper opens.

    Args:
        body: in the object's frame.
        mass: kg.
        foot, top: lowest and highest point over the origin, m.

    Raises:
        ValueError: the pads would touch no part of the body.
    """
    height = max((foot + top) / 2 + _HEIGHT_OVER_MIDDLE, foot + _MIN_TABLE_DISTANCE)
    height = max(min(height, top - _MIN_TOP_DEPTH), top - _MAX_TOP_DEPTH)
    centre = (float(body.centre[0]), float(body.centre[1]))
    body = PointBody(body.points[np.abs(body.points[:, 2] - height) <= _HALF_PAD], body.step)
    widths = {axis: found for axis in _AXES_DEG if (found := body.width_between_pads(height, axis, centre, _HALF_PAD))}
    least = min(width for width, _ in widths.values())
    best = _middle_of_headings([axis for axis, (width, _) in widths.items() if width <= least + body.step / 2])
    points = [_grasp_point(body, height, best, centre)]
    points += [
        _grasp_point(body, height, other, centre)
        for turn in (90, 45, 135)
        if widths.get(other := (best + turn) % 180, (math.inf, 0))[0] <= least + _WIDTH_TOLERANCE
    ]
    along = np.array([-math.sin(math.radians(best)), math.cos(math.radians(best))])
    if len(points) == 1:
        for offset in _GRASP_POINT_SHIFTS:
            at = (centre[0] + float(offset * along[0]), centre[1] + float(offset * along[1]))
            found = body.width_between_pads(height, best, at, _HALF_PAD)
            if found and found[0] <= least + _WIDTH_TOLERANCE:
                points.append(_grasp_point(body, height, best, at))
    force = max(_MIN_FORCE, _WEIGHT_FACTOR * mass * 9.81 / 2)
    return {**points[0], "friction": {"force": round(force, 1), "points": points}}


def _middle_of_headings(axes: list[int]) -> int:
    """Return the middle of the first run of consecutive headings, degrees; 0 for a round outline."""
    if len(axes) > _MIN_ROUND_HEADINGS:
        return 0
    # A run may wrap around at 180 degrees.
    start = next(axis for axis in axes if (axis - 1) % 180 not in axes)
    length = next(k for k in range(180) if (start + k) % 180 not in axes)
    return (start + (length - 1) // 2) % 180


def _grasp_point(body: PointBody, height: float, axis: int, at: tuple[float, float]) -> dict[str, Any]:
    found = body.width_between_pads(height, axis, at, _HALF_PAD)
    assert found is not None
    width, middle = found
    angle = math.radians(axis)
    position = [at[0] + middle * math.cos(angle), at[1] + middle * math.sin(angle), height]
    return {"position": [round(x, 4) for x in position], "axis_deg": float(axis), "opening": round(width / 2, 4)}
