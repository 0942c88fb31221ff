"""Put what a hand holds down where there is room."""

from __future__ import annotations

import math

import numpy as np

from ..geometry.se3 import Array, pose, rotation_z, yaw
from ..goals.cast import Cast
from ..goals.world import TABLE
from .bench import Bench
from .place import Placing

# Headings that are tried, as turns from the present one.
_TURNS = (0.0, math.pi / 2, -math.pi / 2, math.pi)


class PutAside(Placing):
    """Put a thing down on the table where there is room, near both arms, and where nothing started.

    Attributes:
        thing: a role; it is in a hand.
    """

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        places = [
            place
            for place in bench.middle_places()
            if bench.is_free(thing, place) and not self._is_wanted(bench, thing, place)
        ]
        heading = yaw(bench.world.pose(thing))
        return [
            pose((*place, bench.height_on(thing, place, TABLE, heading + turn)), rotation_z(heading + turn))
            for place in places
            for turn in _TURNS
        ]

    @staticmethod
    def _is_wanted(bench: Bench, thing: str, place: Array) -> bool:
        """Whether a thing there would be in the way where things started: one may have to come there."""
        wide = float(np.hypot(*bench.half_outline(thing, 0.0)))
        return any(
            float(np.linalg.norm(bench.world.start(other)[:2, 3] - place))
            < wide + float(np.hypot(*bench.half_outline(other, 0.0)))
            for other in bench.world.things
        )
