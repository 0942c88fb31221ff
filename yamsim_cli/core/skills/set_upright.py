"""Stand a thing up that lies on its side, or on its head."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ..geometry.se3 import Array, pose, rotation_z
from ..goals.cast import Cast
from ..goals.world import TABLE
from .bench import Bench
from .place import Placing

# How far from where it lies a thing may come to stand, in rings of so many places, m.
_RINGS = (0.0, 0.05, 0.10)
_PLACES = 6

_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))


class SetUpright(Placing):
    """Put a thing down upright, near where it was taken from.

    Attributes:
        thing: a role; it is in a hand.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)

    def support(self, cast: Cast) -> str:
        """See `Placing`."""
        return TABLE

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        low, high = bench.world.bounds(thing)
        middle = (low[:2] + high[:2]) / 2
        found = []
        for ring in _RINGS:
            for k in range(_PLACES if ring else 1):
                angle = 2 * math.pi * k / _PLACES
                place = middle + ring * np.array((math.cos(angle), math.sin(angle)))
                if bench.is_free(thing, place):
                    height = bench.height_on(thing, place, TABLE, 0.0)
                    found += [pose((*place, height), rotation_z(heading)) for heading in _HEADINGS]
        return found
