"""Where a hand from above holds a fitted shape: across its narrowest side, near its middle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .body import Body

# Smallest height of a grasp above the table, m. Any lower, a leaning hand's lower pad would touch the table.
_OVER_TABLE = 0.0235
# Smallest depth of a grasp below the top, m. Any higher, a pad would hold only with its edge.
_UNDER_TOP = 0.010
# Largest depth of a grasp below the top, m. Any deeper, the palm would touch the top.
_PALM = 0.045
# Height of a grasp above the thing's middle, m, so that it hangs steadily.
_OVER_MIDDLE = 0.004

# Half the width and height of the patch that a pad presses on, m.
_PAD = 0.008
_AXES_DEG = range(180)
# An outline that is as narrow as at its narrowest over more headings than this counts as round, degrees.
_ROUND = 60
# A grasp counts as equally narrow if it is wider than the narrowest one by no more than this, m.
_LIKE = 0.002
# How far along the object other places to hold it are, m.
_ASIDE = (0.015, -0.015)

# Force of each pad: as much as on the banana, N, and for heavier things so many times half the weight.
_FORCE = 15.0
_TIMES_WEIGHT = 8.0


def grasp(body: Body, mass: float, foot: float, top: float) -> dict[str, Any]:
    """The `grasp` of an object's config, for a body in the object's frame, whether or not a gripper opens so wide.

    Args:
        mass: the body's mass, kg.
        foot, top: heights of its lowest and highest point above the object's origin, m.
    """
    height = max((foot + top) / 2 + _OVER_MIDDLE, foot + _OVER_TABLE)
    height = max(min(height, top - _UNDER_TOP), top - _PALM)
    centre = (float(body.centre[0]), float(body.centre[1]))
    # What pads of that height can touch at all: most of a body is elsewhere.
    body = Body(body.points[np.abs(body.points[:, 2] - height) <= _PAD], body.step)
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
        for aside in _ASIDE:
            at = (centre[0] + float(aside * along[0]), centre[1] + float(aside * along[1]))
            found = body.width(height, best, at, _PAD)
            if found and found[0] <= least + _LIKE:
                points.append(_point(body, height, best, at))
    force = max(_FORCE, _TIMES_WEIGHT * mass * 9.81 / 2)
    return {**points[0], "friction": {"force": round(force, 1), "points": points}}


def _middle(axes: list[int]) -> int:
    """The middle of the first run of neighbouring directions, degrees; 0 for a round outline."""
    if len(axes) > _ROUND:
        return 0
    # A run may continue past 180 degrees.
    start = next(axis for axis in axes if (axis - 1) % 180 not in axes)
    length = next(k for k in range(180) if (start + k) % 180 not in axes)
    return (start + (length - 1) // 2) % 180


def _point(body: Body, height: float, axis: int, at: tuple[float, float]) -> dict[str, Any]:
    found = body.width(height, axis, at, _PAD)
    assert found is not None  # the caller has found something there
    width, middle = found
    angle = math.radians(axis)
    position = [at[0] + middle * math.cos(angle), at[1] + middle * math.sin(angle), height]
    return {"position": [round(x, 4) for x in position], "axis_deg": float(axis), "opening": round(width / 2, 4)}
