"""Stand a thing up that lies on its side, or on its head."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ..geometry.se3 import Array, pose, rotation_z, tilt
from ..goals.cast import Cast
from ..goals.world import TABLE
from ..types import Cause
from .base import Skill, holder_of
from .bench import Bench, Segment, SkillFailedError
from .pick import Pick
from .place import Placing

# How far from where it lies a thing may come to stand, in rings of so many places, m.
_RINGS = (0.0, 0.05, 0.10, 0.15, 0.20)
_PLACES = 8

_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))

# What leans more than this has fallen over again, rad.
_STANDS = math.radians(10)


class SetUpright(Placing):
    """Put a thing down upright, near where it was taken from. What is in no hand yet is taken first; where it lies so
    that no hand can take it and set it upright, it is turned before.

    Attributes:
        thing: a role.
    """

    NEEDS: ClassVar[bool | None] = None

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing, taking = cast.one(self.thing), Pick(thing=self.thing)
        if holder_of(bench, thing) is None:
            try:
                yield from taking.run(bench, cast, (self,))
            except SkillFailedError as error:
                if error.cause is not Cause.UNREACHABLE or holder_of(bench, thing) is not None:
                    raise
                turning = Turn(thing=self.thing)
                yield from taking.run(bench, cast, (turning,))
                yield from turning.run(bench, cast, (taking,))
                yield from taking.run(bench, cast, (self,))
        yield from super().run(bench, cast, ahead)

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

    def _check(self, bench: Bench, thing: str, onto: str, T_goal: Array) -> None:
        super()._check(bench, thing, onto, T_goal)
        if (leans := tilt(bench.world.pose(thing)[:3, :3])) > _STANDS:
            raise SkillFailedError(Cause.OFF_TARGET, f"the {thing} leans by {math.degrees(leans):.0f} degrees")


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
