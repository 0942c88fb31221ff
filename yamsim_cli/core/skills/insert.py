"""Put a held thing into a container."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ..geometry.se3 import Array, pose, rotation_z, yaw
from ..goals.cast import Cast
from .bench import Bench
from .place import Placing

_GRID_STEP = 0.03  # m, between the places in a container that are tried
_HEIGHT_STEP = 0.01  # m, resting heights are compared in these steps; at equal height the more central place is better

# share of the volume. A thing that fell over is in the container if at least this share is inside; tall things do not
# go deep.
_MIN_SHARE_INSIDE = 0.3

# rad, headings relative to the container's, in the order tried
_TURNS = tuple(math.radians(angle) for angle in (0, 180, 90, -90))


class Insert(Placing):
    """Put a thing where it rests lowest in a container, near the container's middle.

    Attributes:
        thing: a role; it is in a hand.
        into: a role: the container.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into")
    into: str

    def support(self, cast: Cast) -> str:
        """See `Placing`."""
        return cast.one(self.into)

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        container = cast.one(self.into)
        T, (low, high) = bench.world.pose(container), bench.world.block(container)
        bottom, top = bench.world.block(thing)
        foot = np.array([*(bottom + top)[:2] / 2, bottom[2], 1.0])
        found = []
        for turn in _TURNS:
            heading = yaw(T) + turn
            half = bench.half_outline(thing, turn)
            ranges = [(low[k] + half[k], high[k] - half[k]) for k in (0, 1)]
            if any(first > last for first, last in ranges):
                continue
            middles = [(first + last) / 2 for first, last in ranges]
            for x in _grid(*ranges[0]):
                for y in _grid(*ranges[1]):
                    place = (T @ (x, y, 0.0, 1.0))[:2]
                    height = bench.height_on(thing, place, container, heading)
                    T_goal = pose((*place, height), rotation_z(heading))
                    offset = float(np.hypot(x - middles[0], y - middles[1]))
                    # The block around a container also covers space outside of its walls.
                    if bench.world.inside(container, (T_goal @ foot)[None, :3])[0]:
                        found.append((round(height / _HEIGHT_STEP), offset, T_goal))
        return [T_goal for *_, T_goal in sorted(found, key=lambda each: each[:2])]

    def _check(self, bench: Bench, thing: str, onto: str, T_goal: Array) -> None:
        if bench.world.share_inside(thing, onto) < _MIN_SHARE_INSIDE:
            super()._check(bench, thing, onto, T_goal)


def _grid(first: float, last: float) -> Array:
    return np.linspace(first, last, max(1, math.ceil((last - first) / _GRID_STEP)) + 1)
