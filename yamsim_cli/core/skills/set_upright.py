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
_PLACES_PER_RING = 8

_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))

# What leans more than this has fallen over again, rad.
_MAX_TILT = math.radians(10)


class SetUpright(Placing):
    """Put a thing down upright, near where it was taken from. What is in no hand yet is taken first; where it lies so
    that no hand can take it and set it upright, it is turned before.

    Attributes:
        thing: a role.
    """

    NEEDS_HELD: ClassVar[bool | None] = None

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing, pick = cast.one(self.thing), Pick(thing=self.thing)
        if holder_of(bench, thing) is None:
            try:
                yield from pick.run(bench, cast, (self,))
            except SkillFailedError as error:
                if error.cause is not Cause.UNREACHABLE or holder_of(bench, thing) is not None:
                    raise
                turn_skill = Turn(thing=self.thing)
                yield from pick.run(bench, cast, (turn_skill,))
                yield from turn_skill.run(bench, cast, (pick,))
                yield from pick.run(bench, cast, (self,))
        yield from super().run(bench, cast, ahead)

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        low, high = bench.world.bounds(thing)
        middle = (low[:2] + high[:2]) / 2
        found = []
        for ring in _RINGS:
            for k in range(_PLACES_PER_RING if ring else 1):
                angle = 2 * math.pi * k / _PLACES_PER_RING
                place = middle + ring * np.array((math.cos(angle), math.sin(angle)))
                if bench.is_free(thing, place):
                    height = bench.height_on(thing, place, TABLE, 0.0)
                    found += [pose((*place, height), rotation_z(heading)) for heading in _HEADINGS]
        return found

    def _check(self, bench: Bench, thing: str, onto: str, T_goal: Array) -> None:
        super()._check(bench, thing, onto, T_goal)
        if (leans := tilt(bench.world.pose(thing)[:3, :3])) > _MAX_TILT:
            raise SkillFailedError(Cause.OFF_TARGET, f"the {thing} leans by {math.degrees(leans):.0f} degrees")


# How far the upper end may come to point deviation the way towards the arms, rad, and how far from where the thing lies it
# may be put, m. The arms reach best what is shift.
_DEVIATIONS = tuple(math.radians(angle) for angle in (0, 30, -30, 60, -60))
_SHIFTS = (0.0, 0.06, 0.12)

# It comes down from so high, m.
_DROP_FROM = 0.2


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
        for shift in _SHIFTS:
            for deviation in _DEVIATIONS:
                turn = math.atan2(towards[1], towards[0]) + deviation - math.atan2(T[1, 2], T[0, 2])
                R = rotation_z(turn)
                origin = middle + R @ (T[:3, 3] - middle)
                origin[:2] += shift * towards
                T_goal = pose((*origin[:2], table + _DROP_FROM), R @ T[:3, :3])
                T_goal[2, 3] = bench.obstacles.rest_height(bench.qpos, thing, T_goal, table - _DROP_FROM)
                found.append(T_goal)
        return found
