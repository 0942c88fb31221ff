"""Put a thing that lies on its side down as it lies, its upper end towards the arms."""

from __future__ import annotations

import math

import numpy as np

from ..geometry.se3 import Array, pose, rotation_z
from ..goals.cast import Cast
from ..goals.world import TABLE
from .bench import Bench
from .place import Placing

# How far the upper end may come to point off the way towards the arms, rad, and how far from where the thing lies it
# may be put, m. The arms reach best what is nearer.
_OFF = tuple(math.radians(angle) for angle in (0, 30, -30, 60, -60))
_NEARER = (0.0, 0.06, 0.12)

# It comes down from so high, m.
_OVER = 0.2


class Turn(Placing):
    """Turn a thing that lies: put it down as it lay, its z axis towards the arms.

    Attributes:
        thing: a role; it is in a hand.
    """

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        T, table = bench.world.pose(thing), float(bench.world.bounds(TABLE)[1][2])
        low, high = bench.world.bounds(thing)
        middle = (low + high) / 2
        towards = bench.middle - middle[:2]
        towards /= np.linalg.norm(towards)
        found = []
        for nearer in _NEARER:
            for off in _OFF:
                turn = math.atan2(towards[1], towards[0]) + off - math.atan2(T[1, 2], T[0, 2])
                R = rotation_z(turn)
                at = middle + R @ (T[:3, 3] - middle)
                at[:2] += nearer * towards
                T_goal = pose((*at[:2], table + _OVER), R @ T[:3, :3])
                T_goal[2, 3] = bench.obstacles.rest_height(bench.qpos, thing, T_goal, table - _OVER)
                found.append(T_goal)
        return found
