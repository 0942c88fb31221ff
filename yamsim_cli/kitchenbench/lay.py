"""Lay a long thing into a compartment of a tray."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ..core.geometry.se3 import Array, pose, rotation_z
from ..core.goals.cast import Cast
from ..core.sim.world import SimWorld
from ..core.skills.bench import Bench
from ..core.skills.hand import PASSING, Hand
from ..core.skills.place import OVER, Placing, raised
from ..core.tasks.casting import gap, outline

# How finely places in a compartment are tried, m. A place that is lower by so much is the better one; and one that has
# so much room to all else is better than any other.
_GRID, _LOWER, _FREE = 0.02, 0.001, 0.003
# So many of either are offered.
_MOST = 12
# A thing whose z axis points up less than the first one of these, as sines, may stay as it is; and less than the second
# one, lies on its side or on its head.
_UPRIGHT, _HANGING = 0.95, 0.6


class Lay(Placing):
    """Lay a long thing along a compartment, beside what lies there already if there is room, else on it.

    Attributes:
        thing: a role; it is in a hand.
        into: a compartment.
        beside: a role: what may lie there.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into", "beside")
    LOWERING: ClassVar[float] = 0.25
    into: str
    beside: str

    def support(self, cast: Cast) -> str:
        """See `Placing`."""
        return cast.one(self.into)

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        world, into = bench.world, cast.one(self.into)
        T, (low, high), block = world.pose(into), world.block(into), world.block(thing)
        others = [outline(world.block(name), world.pose(name)) for name in cast.of(self.beside) if name != thing]
        free, taken = list[tuple[float, Array]](), list[tuple[float, Array]]()
        for R in _along(world, thing, T):
            corners = outline(block, pose(rotation=T[:3, :3].T @ R))
            first, last = low[:2] - corners.min(axis=0), high[:2] - corners.max(axis=0)
            if (first > last).any():
                continue
            for x in _spread(first[0], last[0]):
                for y in _spread(first[1], last[1]):
                    T_goal = pose((T @ (x, y, 0.0, 1.0))[:3], R)
                    off = math.hypot(*((x, y) - (first + last) / 2))
                    there = outline(block, T_goal)
                    (taken if any(gap(there, other) < _FREE for other in others) else free).append((off, T_goal))
        free = sorted(free, key=lambda each: each[0])
        free = free[:: math.ceil(len(free) / _MOST)] if free else []
        for _, T_goal in free[:1] + taken:
            T_goal[2, 3] = bench.height_of(thing, T_goal, into)
        for _, T_goal in free[1:]:
            T_goal[2, 3] = free[0][1][2, 3]
        taken.sort(key=lambda each: (round(each[1][2, 3] / _LOWER), each[0]))
        return [T_goal for _, T_goal in free + taken[:_MOST]]

    def _over(self, hand: Hand, T_pinch: Array) -> Array | None:
        """See `Placing`; else by way of the place itself, from where a pick has found this way."""
        joints = super()._over(hand, T_pinch)
        if joints is None and (there := hand.reach(T_pinch, (hand.joints, hand.ready), PASSING)) is not None:
            joints = hand.reach(raised(T_pinch, OVER), (there,), PASSING)
        return joints


def _along(world: SimWorld, thing: str, T: Array) -> list[Array]:
    """How a long thing may lie in a compartment at (4, 4): rotations (3, 3) in `world`, either way round. One that lies
    on its side, or on its head, stays so.
    """
    low, high = world.block(thing)
    now, longest = world.pose(thing)[:3, :3], int(np.argmax(high - low))
    wanted = math.atan2(T[1, 1], T[0, 1])
    lying = [np.eye(3)] if now[2, 2] > _UPRIGHT else [np.eye(3), now] if now[2, 2] > _HANGING else [now]
    return [
        rotation_z(wanted + turn - math.atan2(R[1, longest], R[0, longest])) @ R
        for R in lying
        for turn in (0.0, math.pi)
    ]


def _spread(first: float, last: float) -> Array:
    return np.linspace(first, last, max(1, math.ceil((last - first) / _GRID)) + 1)
