"""Give a thing from one hand to the other, in the air."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..documents.units import Distance
from ..geometry.se3 import Array, inverse, pose, rotation_from_vector
from ..goals.cast import Cast
from ..goals.world import TABLE
from ..planning.obstacles import Load
from ..types import Cause
from .base import Skill, hand_with, preferences
from .bench import Bench, Fingers, Segment
from .errors import SkillFailedError
from .grips import Grip, points_well
from .hand import PASSING, Hand, Held
from .moves import let_go, rest, take_hold

# From so far the taking hand comes straight, m.
_APPROACH = 0.08

# Where hands meet: how far ahead of the middle between their bases, m.
_AHEAD = (0.32, 0.26, 0.38, 0.44)

# Two hands whose fingers point less far apart than this are in each other's way; and from here on they point at each
# other, and may be turned about that line, rad.
_LEAST_ANGLE = math.radians(50)
_OPPOSITE = math.radians(165)
# But for hands that hold a long thing side by side, so far apart, m: fingers with room between them; and where there is
# no such meeting, fingers that only just pass each other, lower over the table, where both come from above.
_SIDE_BY_SIDE, _CLOSE = 0.13, 0.07
_LOWER = (0.0, 0.06, 0.12)

_ROLLS = tuple(math.radians(angle) for angle in (0, 90, 180, -90))


@dataclass(frozen=True)
class _Meeting:
    """Where the hands meet, and the joints (dof,) of both: the giving one's, the taking one's before it and at it."""

    T_thing_in_world: Array
    giving: Array
    before: Array
    taking: Array
    grip: Grip
    wide: float


class Handover(Skill):
    """Bring a thing to where both hands reach it, let the other hand take it, and let go.

    Attributes:
        thing: a role; it is in a hand.
        to: which hand is to have it then.
        height: of its origin over the table, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS: ClassVar[bool | None] = True
    LEAVES: ClassVar[bool | None] = True
    thing: str
    to: Literal["left", "right", "first", "second", "other"] = "other"
    height: Distance = 0.22

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        giver = hand_with(bench, thing, "handed over")
        if bench.side_of(self.to) == giver.side:
            return
        taker = next(hand for hand in bench.hands if hand is not giver)
        meeting = self._meeting(bench, cast, giver, taker, ahead)
        held = bench.look_at(giver)
        load = Load(thing, held.T_thing_in_pinch)
        yield bench.segment({giver: bench.way(giver, meeting.giving, load=load)})
        path = bench.way(taker, meeting.before, meeting.wide)
        yield bench.segment({taker: path}, {taker: Fingers(meeting.wide)})
        T_grip = bench.world.pose(thing) @ meeting.grip.T_pinch_in_thing
        yield bench.segment({taker: bench.line(taker, T_grip)})
        yield from take_hold(bench, taker, meeting.grip)
        if taker.side not in bench.world.holders(thing):
            yield from let_go(bench, taker, meeting.grip.clearance)
            raise SkillFailedError(Cause.SLIPPED, f"the {thing} is not between the {taker.side} hand's fingers")
        taker.held = Held(thing, inverse(bench.T_pinch(taker)) @ bench.world.pose(thing))
        yield from let_go(bench, giver, bench.clearance(thing))
        yield rest(bench)
        bench.look_at(taker)

    def fault(
        self,
        bench: Bench,
        cast: Cast,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        joints: Array,
        ahead: Sequence[Skill] = (),
    ) -> str | None:
        """See `Skill`."""
        if cast.one(self.thing) != thing or bench.side_of(self.to) == hand.side:
            return None
        taker = next(other for other in bench.hands if other is not hand)
        suitable = self._suitable(bench, cast, taker, thing, ahead)
        if next(self._meetings(bench, hand, taker, Held(thing, T_thing_in_pinch), suitable), None):
            return None
        whys = [self._unsuitable(bench, cast, taker, thing, ahead, grip) for grip in bench.grips(thing, taker.widest)]
        return whys[-1] if whys and all(whys) else f"no place where the {taker.side} hand can take it"

    def _meeting(self, bench: Bench, cast: Cast, giver: Hand, taker: Hand, ahead: Sequence[Skill]) -> _Meeting:
        """The first meeting after which the next skill can go on; without one, the first at all."""
        held = bench.look_at(giver)
        for following in preferences(ahead, bench, cast):
            suitable = self._suitable(bench, cast, taker, held.thing, following)
            if (found := next(self._meetings(bench, giver, taker, held, suitable), None)) is not None:
                return found
        anyhow = bench.grips(held.thing, taker.widest)
        if (found := next(self._meetings(bench, giver, taker, held, anyhow), None)) is not None:
            return found
        raise SkillFailedError(Cause.UNREACHABLE, f"no place where both hands reach the {held.thing}")

    def _suitable(self, bench: Bench, cast: Cast, taker: Hand, thing: str, ahead: Sequence[Skill]) -> Iterator[Grip]:
        """The grips of the taking hand with which the next skill can go on."""
        for grip in bench.grips(thing, taker.widest):
            if self._unsuitable(bench, cast, taker, thing, ahead, grip) is None:
                yield grip

    def _unsuitable(
        self, bench: Bench, cast: Cast, taker: Hand, thing: str, ahead: Sequence[Skill], grip: Grip
    ) -> str | None:
        """Why the next skill could not go on with a grip of the taking hand; None if it could."""
        if not ahead:
            return None
        T = inverse(grip.T_pinch_in_thing)
        key = (self, taker.side, thing, tuple(ahead), T.tobytes(), grip.opening)
        return bench.once(key, lambda: ahead[0].fault(bench, cast, taker, thing, T, taker.ready, ahead[1:]))

    def _meetings(
        self, bench: Bench, giver: Hand, taker: Hand, held: Held, grips: Iterable[Grip]
    ) -> Iterator[_Meeting]:
        """Where both hands reach the thing and touch nothing, the taking hand holding it by one of some grips."""
        bases = [hand.arm.T_base_in_world[:3, 3] for hand in (giver, taker)]
        middle, across = (bases[0] + bases[1]) / 2, bases[1] - bases[0]
        across = across / np.linalg.norm(across)
        height = float(bench.world.bounds(TABLE)[1][2]) + self.height
        T_giving = inverse(held.T_thing_in_pinch)
        known = list(grips)
        for apart, lower in ((_SIDE_BY_SIDE, 0.0), *((_CLOSE, lower) for lower in _LOWER)):
            for grip in known:
                for R in _turned(T_giving, grip.T_pinch_in_thing, across, apart):
                    for ahead in _AHEAD:
                        T_thing = pose((middle[0] + ahead, middle[1], height - lower), R)
                        found = self._met(bench, giver, taker, held, grip, T_thing)
                        if found is not None:
                            yield found

    def _met(self, bench: Bench, giver: Hand, taker: Hand, held: Held, grip: Grip, T_thing: Array) -> _Meeting | None:
        T_giving, T_taking = T_thing @ inverse(held.T_thing_in_pinch), T_thing @ grip.T_pinch_in_thing
        if not points_well(T_giving, giver.arm.T_base_in_world) or not points_well(T_taking, taker.arm.T_base_in_world):
            return None
        taking = taker.reach(T_taking, (taker.ready,))
        giving = None if taking is None else giver.reach(T_giving, (giver.joints, giver.ready), PASSING)
        if taking is None or giving is None:
            return None
        if bench.touched(giver, giving, giver.opening, Load(held.thing, held.T_thing_in_pinch)):
            return None
        there = bench.imagined(giver, giving, giver.opening, held)
        wide = min(grip.opening + grip.clearance, taker.widest)
        if bench.obstacles.touched(there, taker.number, taking, wide, between=held.thing):
            return None
        before = taker.reach(T_taking @ pose((0.0, 0.0, -_APPROACH)), (taking,), PASSING)
        if before is None or bench.obstacles.touched(there, taker.number, before, wide):
            return None
        return _Meeting(T_thing, giving, before, taking, grip, wide)


def _turned(T_giving: Array, T_taking: Array, across: Array, side_by_side: float) -> Iterator[Array]:
    """Rotations (3, 3) of a thing in `world` for which both hands come from their own side, and as much from above.

    Args:
        T_giving, T_taking: the hands' pinch frames (4, 4) in the thing's.
        side_by_side: how far apart hands that point the same way have to be, m.
        across: from the giving arm's base to the taking arm's (3,), in `world`.
    """
    giving, taking = T_giving[:3, 2], T_taking[:3, 2]
    apart = T_taking[:3, 3] - T_giving[:3, 3]
    angle = math.acos(max(-1.0, min(1.0, float(giving @ taking))))
    if angle >= _LEAST_ANGLE:
        one = giving - taking
    elif np.linalg.norm(apart) >= side_by_side:
        one = apart
    else:
        return
    one = one / np.linalg.norm(one)
    two = giving + taking
    if angle > _OPPOSITE:
        # Any direction beside that line may be the one from above; the thing's own is tried first.
        two = np.array((0.0, 0.0, -1.0)) if abs(one[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    two = two - (two @ one) * one
    if np.linalg.norm(two) < 0.1:
        return
    two = two / np.linalg.norm(two)
    down = np.array((0.0, 0.0, -1.0))
    world = np.column_stack([across, down, np.cross(across, down)])
    thing = np.column_stack([one, two, np.cross(one, two)])
    for roll in _ROLLS if angle > _OPPOSITE else _ROLLS[:1]:
        yield rotation_from_vector(across * roll) @ world @ thing.T
