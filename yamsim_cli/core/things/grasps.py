"""Where a hand from above takes a fitted shape: across its narrowest side, near its middle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .body import Body

# Lower, a leaning hand's lower pad would touch the table; nearer to the top, a pad would hold by its edge; deeper, the
# palm would come down on the top; m.
_OVER_TABLE = 0.0235
_UNDER_TOP = 0.010
_PALM = 0.045
# A thing hangs the steadier, the higher over its middle it is held, m.
_OVER_MIDDLE = 0.004

# Half the width and height of a finger's pad, m. Source: MuJoCo Menagerie i2rt_yam, linear_4310.
_PAD = 0.008
_AXES_DEG = range(180)
# What is equally wide over more than this is round, degrees.
_ROUND = 60
# As narrow as the narrowest, m.
_LIKE = 0.002
# Other places along the object, m.
_ASIDE = (0.015, -0.015)

# What a pad presses with: as much as on the banana, N, and on what is heavier so many times half its weight.
_FORCE = 15.0
_TIMES_WEIGHT = 8.0


def grasp(body: Body, mass: float, foot: float, top: float) -> dict[str, Any]:
    """The `grasp` of an object's config, for a body in the object's frame; what no gripper opens wide enough for too.

    Args:
        mass: kg.
        foot, top: its lowest and highest point over the object's origin, m.
    """
    height = max((foot + top) / 2 + _OVER_MIDDLE, foot + _OVER_TABLE)
    height = max(min(height, top - _UNDER_TOP), top - _PALM)
    centre = (float(body.centre[0]), float(body.centre[1]))
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
    """The middle of the first run of neighbouring directions, degrees; 0 for a round thing's."""
    if len(axes) > _ROUND:
        return 0
    # A run may go on past 180 degrees.
    start = next(axis for axis in axes if (axis - 1) % 180 not in axes)
    length = next(k for k in range(180) if (start + k) % 180 not in axes)
    return (start + (length - 1) // 2) % 180


def _point(body: Body, height: float, axis: int, at: tuple[float, float]) -> dict[str, Any]:
    found = body.width(height, axis, at, _PAD)
    assert found is not None  # there is something where the caller looked
    width, middle = found
    angle = math.radians(axis)
    position = [at[0] + middle * math.cos(angle), at[1] + middle * math.sin(angle), height]
    return {"position": [round(x, 4) for x in position], "axis_deg": float(axis), "opening": round(width / 2, 4)}
