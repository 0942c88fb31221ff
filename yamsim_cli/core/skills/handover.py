"""Give a thing from one hand to the other, in the air."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..documents.units import Distance
from ..geometry.se3 import Array, inverse, pose, rotation_from_vector, rotation_z
from ..goals.cast import Cast
from ..goals.world import TABLE
from ..planning.obstacles import Load
from ..types import Cause
from .base import Skill, hand_with, preferences
from .bench import Bench, Fingers, Segment
from .cached_iterable import CachedIterable
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
# How hands meet: at least how far apart they hold a long thing if they come from the same side, m; how much lower than
# usual, m; and by how much the line from the giving to the taking hand is turned from the line between the bases, rad.
# Fingers with room between them come first, then fingers that only just pass each other, then lower places, which hands
# reach from above.
_MEETINGS = ((0.13, 0.0, 0.0), (0.07, 0.0, 0.0), (0.07, 0.06, 0.0), (0.07, 0.12, 0.0))
_TURNS = tuple(math.radians(angle) for angle in (30, -30, 60, -60))
_MORE_MEETINGS = (*_MEETINGS, *((0.07, lower, turn) for turn in _TURNS for lower in (0.0, 0.06)))

_ROLLS = tuple(math.radians(angle) for angle in (0, 90, 180, -90))


@dataclass(frozen=True)
class _Meeting:
    """How hands meet.

    Attributes:
        grip: the taking hand's.
        wide: opening of one of its fingers before it closes, m.
        giving: joints (dof,) of the giving arm, rad.
        before, taking: joints (dof,) of the taking arm before it comes to the thing, and at it, rad.
    """

    grip: Grip
    wide: float
    giving: Array
    before: Array
    taking: Array


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
    MEETINGS: ClassVar[tuple[tuple[float, float, float], ...]] = _MEETINGS
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
        if self._meeting_before(bench, cast, hand, taker, Held(thing, T_thing_in_pinch), ahead) is not None:
            return None
        faults = list(_taking_grips(bench, cast, taker, thing, ahead).faults.values())
        return faults[-1] if faults and all(faults) else f"no place where the {taker.side} hand can take it"

    def relaxed(self, bench: Bench, cast: Cast) -> Handover:
        """See `Skill`: the line from hand to hand may be turned from the line between the bases."""
        return _TurnedHandover.model_construct(**dict(self))

    def _meeting(self, bench: Bench, cast: Cast, giver: Hand, taker: Hand, ahead: Sequence[Skill]) -> _Meeting:
        """The first meeting after which the next skill can go on; without one, the first at all."""
        held = bench.look_at(giver)
        for following in (*preferences(ahead, bench, cast), ()):
            for skill in (self, self.relaxed(bench, cast)):
                if (found := skill._meeting_before(bench, cast, giver, taker, held, following)) is not None:
                    return found
        raise SkillFailedError(Cause.UNREACHABLE, f"no place where both hands reach the {held.thing}")

    def _meeting_before(
        self, bench: Bench, cast: Cast, giver: Hand, taker: Hand, held: Held, ahead: Sequence[Skill]
    ) -> _Meeting | None:
        """The first meeting at which both hands reach the thing and touch nothing, and after which skills can go on."""
        grips = _taking_grips(bench, cast, taker, held.thing, ahead)
        # The first search asks about a grip only where hands would meet by it. Later ones have use for every answer.
        ask_first = bool(grips.faults)
        T_giving = inverse(held.T_thing_in_pinch)
        bases = [hand.arm.T_base_in_world[:3, 3] for hand in (giver, taker)]
        middle, across = (bases[0] + bases[1]) / 2, bases[1] - bases[0]
        across = across / np.linalg.norm(across)
        height = float(bench.world.bounds(TABLE)[1][2]) + self.height
        for apart, lower, turn in self.MEETINGS:
            places = [np.array((middle[0] + ahead, middle[1], height - lower)) for ahead in _AHEAD]
            for number, grip in enumerate(grips):
                if grips.faults.get(number) or (ask_first and not grips.suits(number, grip)):
                    continue
                rotations = _turned(T_giving, grip.T_pinch_in_thing, rotation_z(turn) @ across, apart)
                for T_thing in (pose(place, R) for R in rotations for place in places):
                    meeting = _reached(giver, taker, T_thing @ T_giving, T_thing @ grip.T_pinch_in_thing, grip)
                    if meeting is None:
                        continue
                    if not grips.suits(number, grip):
                        break
                    if _is_free(bench, giver, taker, held, meeting):
                        return meeting
        return None


class _TurnedHandover(Handover):
    """A hand-over in which the line from hand to hand may be turned."""

    MEETINGS: ClassVar[tuple[tuple[float, float, float], ...]] = _MORE_MEETINGS

    def relaxed(self, bench: Bench, cast: Cast) -> Handover:
        """See `Skill`."""
        return self


class _TakingGrips:
    """The ways in which a hand may take a thing, the best ones first.

    Attributes:
        faults: number of a way -> why the skills ahead could not go on with it, or None; as far as anybody asked.
    """

    def __init__(self, bench: Bench, cast: Cast, taker: Hand, thing: str, ahead: Sequence[Skill]) -> None:
        self._bench, self._cast, self._taker, self._thing, self._ahead = bench, cast, taker, thing, ahead
        self._grips = CachedIterable(bench.grips(thing, taker.widest))
        self.faults: dict[int, str | None] = {}

    def __iter__(self) -> Iterator[Grip]:
        return iter(self._grips)

    def suits(self, number: int, grip: Grip) -> bool:
        """Whether the skills ahead can go on with the grip that has a number."""
        if number not in self.faults:
            fault = None
            if self._ahead:
                taken = self._taker, self._thing, inverse(grip.T_pinch_in_thing), self._taker.ready
                fault = self._ahead[0].fault(self._bench, self._cast, *taken, self._ahead[1:])
            self.faults[number] = fault
        return self.faults[number] is None


def _taking_grips(bench: Bench, cast: Cast, taker: Hand, thing: str, ahead: Sequence[Skill]) -> _TakingGrips:
    """The same grips for every search while nothing moves: whether one suits does not depend on where hands meet."""
    key = ("taking grips", taker.side, thing, tuple(ahead))
    return bench.once(key, lambda: _TakingGrips(bench, cast, taker, thing, ahead))


def _reached(giver: Hand, taker: Hand, T_giving: Array, T_taking: Array, grip: Grip) -> _Meeting | None:
    """The meeting with the hands' pinch frames at poses (4, 4) in `world`; None where an arm does not reach its own."""
    if not points_well(T_giving, giver.arm.T_base_in_world) or not points_well(T_taking, taker.arm.T_base_in_world):
        return None
    taking = taker.reach(T_taking, (taker.ready,))
    if taking is None:
        return None
    giving = giver.reach(T_giving, (giver.joints, giver.ready), PASSING)
    if giving is None:
        return None
    before = taker.reach(T_taking @ pose((0.0, 0.0, -_APPROACH)), (taking,), PASSING)
    if before is None:
        return None
    return _Meeting(grip, min(grip.opening + grip.clearance, taker.widest), giving, before, taking)


def _is_free(bench: Bench, giver: Hand, taker: Hand, held: Held, meeting: _Meeting) -> bool:
    """Whether neither hand touches anything at a meeting but the thing between its fingers."""
    if bench.touched(giver, meeting.giving, giver.opening, Load(held.thing, held.T_thing_in_pinch)):
        return False
    there = bench.imagined(giver, meeting.giving, giver.opening, held)
    touched, wide = bench.obstacles.touched, meeting.wide
    at_it = touched(there, taker.number, meeting.taking, wide, between=held.thing)
    return not at_it and not touched(there, taker.number, meeting.before, wide)


def _turned(T_giving: Array, T_taking: Array, across: Array, side_by_side: float) -> Iterator[Array]:
    """Rotations (3, 3) of a thing in `world` for which both hands come from their own side, and as much from above.

    Args:
        T_giving, T_taking: the hands' pinch frames (4, 4) in the thing's.
        side_by_side: how far apart hands that point the same way have to be, m.
        across: direction (3,) of the line from the giving to the taking hand, in `world`.
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
