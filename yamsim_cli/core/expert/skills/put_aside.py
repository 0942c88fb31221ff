"""Put a held thing down where there is room."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...config.goals.cast import Cast
from ...config.goals.world import TABLE
from ...geometry.se3 import Array, pose, rotation_z, yaw
from .base import Side, Skill, require_holder
from .bench import Bench, Segment, SkillFailedError
from .hand import Hand
from .moves import let_go
from .pick import Pick
from .place import Placing

# rad, headings relative to the present heading, in the order tried
_TURNS = (0.0, math.pi / 2, -math.pi / 2, math.pi)

# m and count; if there is no room between the arms: radii of rings around the present position, and places on each
_RINGS, _DIRECTIONS = (0.0, 0.06, 0.12, 0.18), 8


class PutAside(Placing):
    """Put a thing down on a free place of the table where no thing started: about as near to all acting arms, or if all
    such places are taken, near to where the hand holds the thing.

    Attributes:
        thing: a role; it is in a hand.
    """

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        places = self._free_places(bench, thing, bench.middle_places())
        if not places:
            places = self._free_places(bench, thing, _ring_places(bench.world.pose(thing)[:2, 3]))
        heading = yaw(bench.world.pose(thing))
        return [
            pose((*place, bench.height_on(thing, place, TABLE, heading + turn)), rotation_z(heading + turn))
            for place in places
            for turn in _TURNS
        ]

    def _free_places(self, bench: Bench, thing: str, places: Sequence[Array]) -> list[Array]:
        return [
            place for place in places if bench.is_free(thing, place) and not self._blocks_a_start(bench, thing, place)
        ]

    @staticmethod
    def _blocks_a_start(bench: Bench, thing: str, place: Array) -> bool:
        """Return whether a thing at a point (2,) would overlap a start, to which a thing may have to return."""
        radius = float(np.hypot(*bench.half_outline(thing, 0.0)))
        return any(
            float(np.linalg.norm(bench.world.start(other)[:2, 3] - place))
            < radius + float(np.hypot(*bench.half_outline(other, 0.0)))
            for other in bench.world.things
        )


def _ring_places(place: Array) -> list[Array]:
    """Return points (2,) in rings around a point, the nearest first, m."""
    angles = [2 * math.pi * k / _DIRECTIONS for k in range(_DIRECTIONS)]
    return [
        place + ring * np.array((math.cos(angle), math.sin(angle)))
        for ring in _RINGS
        for angle in (angles if ring else angles[:1])
    ]


def put_back(bench: Bench, cast: Cast, role: str) -> Iterator[Segment]:
    """Put a thing down where there is room, else straight below, and add its grasp to the hand's `failed_grasps`.

    Raises:
        SkillFailedError: no hand holds the thing any more, or it cannot be lowered.
    """
    hand = require_holder(bench, cast.one(role), "taken another way")
    hand.failed_grasps.append(bench.update_held(hand))
    try:
        yield from PutAside(thing=role).run(bench, cast, ())
    except SkillFailedError:
        if hand.held is None:
            raise
        yield from _lower_straight(bench, hand, hand.held.thing)


def _lower_straight(bench: Bench, hand: Hand, thing: str) -> Iterator[Segment]:
    T, T_pinch = bench.world.pose(thing), hand.pinch_at(hand.joints)
    table = float(bench.world.bounds(TABLE)[0][2])
    T_pinch[2, 3] -= T[2, 3] - bench.obstacles.rest_height(bench.qpos, thing, T, table)
    yield bench.segment({hand: bench.line(hand, T_pinch)})
    yield from let_go(bench, hand, bench.clearance(thing))


class Regrasp(Skill):
    """Put a thing down and pick it up again, with an arm and a grip that leave the skills ahead possible.

    Attributes:
        thing: a role; it is in a hand.
        arm: the arm that picks the thing up.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = True
    LEAVES_HELD: ClassVar[bool | None] = True
    thing: str
    arm: Side = "any"

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        yield from PutAside(thing=self.thing).run(bench, cast, ())
        yield from Pick(thing=self.thing, arm=self.arm).run(bench, cast, ahead)
