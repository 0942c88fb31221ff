"""Slide a flat thing away from what it lies beside, so that fingers get around it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.geometry.se3 import Array, pose, rotation_from_vector
from ..core.goals.cast import Cast
from ..core.skills.base import Side, Skill
from ..core.skills.bench import Bench, Fingers, Segment
from ..core.skills.errors import SkillFailedError
from ..core.skills.hand import PASSING, Hand
from ..core.skills.moves import park_free, rest
from ..core.types import Cause

# So much room is looked for on both sides of a thing, and so far it is slid at most; less than this is not worth it, m.
_ROOM, _LEAST = 0.040, 0.005
# What came less far did not slide, m.
_MOVED = 0.002

# Closed fingers press where a thing's top is at most so far above its lowest point, m: where it is higher, it would
# roll. Places are so far apart.
_FLAT, _APART = 0.006, 0.012

# The hand comes down from so far above where it presses, looks whether it would touch anything else so much above it,
# and is told to go so much farther down than to the place where its fingertips touch the thing; m.
_ABOVE, _TOUCHING = 0.07, 0.012

# A pressing hand goes so fast, m/s. What friction takes from its way is added to it, m.
_SLIDING, _SHORT = 0.10, 0.006

# How far the hand may lean to the side, and along the thing, rad.
_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 35, -35))
_LEANS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))


@dataclass(frozen=True)
class _Press:
    """Where a hand presses: its joints (dof,) above, and its pinch frame (4, 4) there and pressing."""

    above: Array
    T_above: Array
    T_press: Array


class Slide(Skill):
    """Press closed fingers onto a thing that lies flat, and draw it sideways to the middle of the room that it has.

    Attributes:
        thing: a role.
        arm: which arm.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS: ClassVar[bool | None] = False
    thing: str
    arm: Side = "any"

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        across = _across(bench, thing)
        one, other = (bench.obstacles.room(bench.qpos, thing, side * across, _ROOM) for side in (1.0, -1.0))
        way = (one - other) / 2
        if abs(way) < _LEAST:
            raise SkillFailedError(Cause.UNREACHABLE, f"the {thing} has no more room on one side than on the other")
        shift = way * across
        before = bench.world.pose(thing)[:2, 3].copy()
        hands = bench.free_hands(self.arm)
        for hand in sorted(hands, key=lambda hand: float(np.linalg.norm(hand.arm.T_base_in_world[:2, 3] - before))):
            for press in self._presses(bench, hand, thing, shift):
                yield from park_free(bench, hand)
                yield from _drawn(bench, hand, press, shift)
                moved = float((bench.world.pose(thing)[:2, 3] - before) @ shift) / abs(way)
                if moved < _MOVED:
                    raise SkillFailedError(Cause.OFF_TARGET, f"the {thing} did not slide")
                return
        raise SkillFailedError(Cause.UNREACHABLE, f"no arm reaches a place where it could press on the {thing}")

    def _presses(self, bench: Bench, hand: Hand, thing: str, shift: Array) -> Iterator[_Press]:
        """The ways in which a hand can press on a thing and slide it, touching nothing else."""
        away = shift / np.linalg.norm(shift)
        down = np.array((0.0, 0.0, -1.0))
        upright = np.column_stack([np.cross((*away, 0.0), down), (*away, 0.0), down])
        far = np.array((*(shift + _SHORT * away), 0.0))
        places = _flat_places(bench, thing, away)
        for tilt, lean, place, turn in itertools.product(_TILTS, _LEANS, places, (0.0, math.pi)):
            turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_from_vector([0.0, lean, 0.0])
            R = upright @ turned @ rotation_from_vector([0.0, 0.0, turn])
            T_press = pose(place, R)
            T_touching, T_above, T_end = (T_press.copy() for _ in range(3))
            T_touching[2, 3] += _TOUCHING
            T_above[2, 3] += _ABOVE
            T_end[:3, 3] += far
            above = hand.reach(T_above, (hand.joints, hand.ready), PASSING)
            if above is None or bench.touched(hand, above, 0.0):
                continue
            touching = hand.reach(T_touching, (above,), PASSING)
            if touching is None or bench.touched(hand, touching, 0.0, between=thing):
                continue
            T_touching[:3, 3] += far
            end = hand.reach(T_touching, (touching,), PASSING)
            if end is None or bench.touched(hand, end, 0.0, between=thing):
                continue
            yield _Press(above, T_above, T_press)


def _drawn(bench: Bench, hand: Hand, press: _Press, shift: Array) -> Iterator[Segment]:
    """Come, press, draw, and leave."""
    closed = {hand: Fingers(0.0)}
    yield bench.segment({hand: bench.way(hand, press.above)}, closed, arrives=False)
    yield bench.segment({hand: bench.line(hand, press.T_press)})
    T_end = press.T_press.copy()
    T_end[:2, 3] += shift * (1.0 + _SHORT / float(np.linalg.norm(shift)))
    yield bench.segment({hand: bench.line(hand, T_end, _SLIDING)})
    T_up = T_end.copy()
    T_up[2, 3] = press.T_above[2, 3]
    yield bench.segment({hand: bench.line(hand, T_up)}, arrives=False)
    yield rest(bench)


def _across(bench: Bench, thing: str) -> Array:
    """The direction (2,) in `world` across a thing that lies: level, at right angles to its longest side."""
    low, high = bench.world.block(thing)
    longest = bench.world.pose(thing)[:2, int(np.argmax(high - low))]
    across: Array = np.array((-longest[1], longest[0])) / np.linalg.norm(longest)
    return across


def _flat_places(bench: Bench, thing: str, away: Array) -> list[Array]:
    """Places (3,) on top of the flat parts of a thing, in `world`, m: the farthest towards where it is to go first."""
    bounds = bench.world.parts(thing)
    lowest, middle = bench.world.bounds(thing)[0][2], bench.world.pose(thing)[:2, 3]
    low = [(*(first + last)[:2] / 2, last[2]) for first, last in bounds if last[2] < lowest + _FLAT]
    found: list[Array] = []
    for place in sorted(map(np.array, low), key=lambda place: -float((place[:2] - middle) @ away)):
        if all(np.linalg.norm(place - other) > _APART for other in found):
            found.append(place)
    return found
