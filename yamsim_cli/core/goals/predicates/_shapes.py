"""How things lie to each other, from the blocks that enclose them."""

from __future__ import annotations

import math

from ...geometry.se3 import Array
from ..world import World


def overlap_xy(world: World, upper: str, lower: str) -> float:
    """How far inside a thing's outline, seen from above, the middle of another lies, m; negative outside."""
    first, last = world.bounds(upper)
    middle = (first + last) / 2
    low, high = world.bounds(lower)
    return float(min(*(middle[:2] - low[:2]), *(high[:2] - middle[:2])))


def bottom(world: World, thing: str) -> float:
    """Height of a thing's lowest point, m."""
    return float(world.bounds(thing)[0][2])


def top(world: World, thing: str) -> float:
    """Height of a thing's highest point, m."""
    return float(world.bounds(thing)[1][2])


def tilt_of(T: Array) -> float:
    """Angle between a pose's z axis and straight up, rad."""
    return math.acos(max(-1.0, min(1.0, float(T[2, 2]))))
