"""Hand a thing over in the air, from one hand to the other."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ...config.goals.cast import Cast
from ...config.goals.world import TABLE
from ...files.documents.units import Distance
from ...geometry.se3 import Array, inverse, pose, rotation_from_vector, rotation_z
from ...types import Cause
from ..planning.obstacles import Load
from .base import Skill, preferences, require_holder
from .bench import Bench, CachedIterable, Fingers, Segment, SkillFailedError
from .grips import Grip, can_point
from .hand import PASSING, Hand, Held
from .moves import let_go, rest, take_hold

_APPROACH = 0.08  # m, length of the straight approach of the taking hand

# m, candidate distances of the meeting in front of the midpoint between the bases, in the order tried
_MEETING_X = (0.32, 0.26, 0.38, 0.44)

_MIN_ANGLE = math.radians(50)  # rad, hands that point less far apart are in each other's way unless side by side
# rad, from here on hands face each other, and the thing may roll about the line between them
_FACING_ANGLE = math.radians(165)
_MIN_APART = 0.07  # m, least distance between hands that come from the same side: their fingers just pass each other
_ROOMY = 0.13  # m, distance between hands from which on their fingers have room between them
# Meetings in the order tried: least and largest distance between the hands, m, infinite unless they come from the same
# side; how much lower than `height`, m; and angle between the line from hand to hand and the line between the bases,
# rad. Fingers with room between them come first, then fingers that just pass each other, then lower places, which hands
# reach from above.
_MEETINGS = (
    (_ROOMY, math.inf, 0.0, 0.0),
    (_MIN_APART, _ROOMY, 0.0, 0.0),
    *((_MIN_APART, math.inf, lower, 0.0) for lower in (0.06, 0.12)),
)
_TURNS = tuple(math.radians(angle) for angle in (30, -30, 60, -60))
_TURNED_MEETINGS = (
    *_MEETINGS,
    *((_MIN_APART, math.inf, lower, turn) for turn in _TURNS for lower in (0.0, 0.06)),
)

# count, giving grips for which `Handover.fault` searches a meeting while nothing moves. A search that finds none takes
# half a second, and a thing in a pile has hundreds of grips.
_MAX_SEARCHES = 24

# count, grips whose poses are tested in one call; a call costs as much as 200 poses in it
_BATCH_SIZE = 256

# rad, of the thing about the line between hands that face each other
_ROLLS = tuple(math.radians(angle) for angle in (0, 90, 180, -90))


@dataclass(frozen=True)
class _Meeting:
    """Grip and joints of both hands at a handover.

    Attributes:
        grip: of the taking hand.
        opening: of each of its fingers before it closes, m.
        giver_joints: of the giving arm (dof,), rad.
        approach_joints: of the taking arm before the straight approach (dof,), rad.
        taker_joints: of the taking arm at the thing (dof,), rad.
    """

    grip: Grip
    opening: float
    giver_joints: Array
    approach_joints: Array
    taker_joints: Array


class Handover(Skill):
    """Move a thing to where both hands reach it, grasp it with the other hand, and release it.

    Attributes:
        thing: a role; it is in a hand.
        to: the hand that holds the thing afterwards.
        height: of the thing's origin over the table, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = True
    LEAVES_HELD: ClassVar[bool | None] = True
    MEETINGS: ClassVar[tuple[tuple[float, float, float, float], ...]] = _MEETINGS
    thing: str
    to: Literal["left", "right", "first", "second", "other"] = "other"
    height: Distance = 0.22

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        giver = require_holder(bench, thing, "handed over")
        if bench.side_of(self.to) == giver.side:
            return
        taker = next(hand for hand in bench.hands if hand is not giver)
        meeting = self._meeting(bench, cast, giver, taker, ahead)
        held = bench.update_held(giver)
        load = Load(thing, held.T_thing_in_pinch)
        yield bench.segment({giver: bench.free_path(giver, meeting.giver_joints, load=load)})
        path = bench.free_path(taker, meeting.approach_joints, meeting.opening)
        yield bench.segment({taker: path}, {taker: Fingers(meeting.opening)})
        T_grip = bench.world.pose(thing) @ meeting.grip.T_pinch_in_thing
        yield bench.segment({taker: bench.line(taker, T_grip)})
        yield from take_hold(bench, taker, meeting.grip)
        if taker.side not in bench.world.holders(thing):
            yield from let_go(bench, taker, meeting.grip.clearance)
            raise SkillFailedError(Cause.SLIPPED, f"the {thing} is not between the {taker.side} hand's fingers")
        taker.held = Held(thing, inverse(bench.T_pinch(taker)) @ bench.world.pose(thing))
        yield from let_go(bench, giver, bench.clearance(thing))
        yield rest(bench)
        bench.update_held(taker)

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
        searches = bench.cached(("searches", self, hand.side, tuple(ahead)), lambda: itertools.count(1))
        if next(searches) > _MAX_SEARCHES:
            return f"no place found where the {taker.side} hand can take it"
        if self._meeting_before(bench, cast, hand, taker, Held(thing, T_thing_in_pinch), ahead) is not None:
            return None
        faults = list(_taking_grips(bench, cast, taker, thing, ahead).faults.values())
        return faults[-1] if faults and all(faults) else f"no place where the {taker.side} hand can take it"

    def relaxed(self, bench: Bench, cast: Cast) -> Handover:
        """See `Skill`: the line from hand to hand may be turned relative to the line between the bases."""
        return _TurnedHandover.model_construct(**dict(self))

    def _meeting(self, bench: Bench, cast: Cast, giver: Hand, taker: Hand, ahead: Sequence[Skill]) -> _Meeting:
        """Return the first meeting that leaves the next skills possible; else the first reachable meeting."""
        held = bench.update_held(giver)
        for following in (*preferences(ahead, bench, cast), ()):
            for skill in (self, self.relaxed(bench, cast)):
                if (found := skill._meeting_before(bench, cast, giver, taker, held, following)) is not None:
                    return found
        raise SkillFailedError(Cause.UNREACHABLE, f"no place where both hands reach the {held.thing}")

    def _meeting_before(
        self, bench: Bench, cast: Cast, giver: Hand, taker: Hand, held: Held, ahead: Sequence[Skill]
    ) -> _Meeting | None:
        """Return the first meeting without contacts that both hands reach and that leaves skills possible."""
        grips = _taking_grips(bench, cast, taker, held.thing, ahead)
        # The first search tests a grip only if hands can meet with it. Later searches profit from every tested grip.
        check_first = bool(grips.faults)
        T_giving = inverse(held.T_thing_in_pinch)
        bases = [hand.arm.T_base_in_world[:3, 3] for hand in (giver, taker)]
        middle, across = (bases[0] + bases[1]) / 2, bases[1] - bases[0]
        across = across / np.linalg.norm(across)
        height = float(bench.world.bounds(TABLE)[1][2]) + self.height
        attitude = functools.cache(lambda grip: _attitude(T_giving, grip.T_pinch_in_thing))
        for least, most, lower, turn in self.MEETINGS:
            places = [np.array((middle[0] + ahead, middle[1], height - lower)) for ahead in _MEETING_X]
            poses = _Poses(rotation_z(turn) @ across, (least, most), np.array(places), attitude)
            for number, grip, T_things in _within_reach(giver, taker, T_giving, grips.open(), poses):
                if check_first and not grips.suits(number, grip):
                    continue
                for T_thing in T_things:
                    meeting = _reached(giver, taker, T_thing @ T_giving, T_thing @ grip.T_pinch_in_thing, grip)
                    if meeting is None:
                        continue
                    if not grips.suits(number, grip):
                        break
                    if _is_free(bench, giver, taker, held, meeting):
                        return meeting
        return None


class _TurnedHandover(Handover):
    """A handover in which the line from hand to hand may be turned."""

    MEETINGS: ClassVar[tuple[tuple[float, float, float, float], ...]] = _TURNED_MEETINGS

    def relaxed(self, bench: Bench, cast: Cast) -> Handover:
        """See `Skill`."""
        return self


class _TakingGrips:
    """Grips by which a hand may take a thing, the most reliable first.

    Attributes:
        faults: number of each tested grip -> why the skills ahead would fail with it; None if they would not.
    """

    def __init__(self, bench: Bench, cast: Cast, taker: Hand, thing: str, ahead: Sequence[Skill]) -> None:
        self._bench, self._cast, self._taker, self._thing, self._ahead = bench, cast, taker, thing, ahead
        self._grips = CachedIterable(bench.grips(thing, taker.max_opening))
        self.faults: dict[int, str | None] = {}

    def open(self) -> Iterator[tuple[int, Grip]]:
        """Yield the number and the grip of all that are untested or suitable."""
        return ((number, grip) for number, grip in enumerate(self._grips) if not self.faults.get(number))

    def suits(self, number: int, grip: Grip) -> bool:
        """Return whether the skills ahead can continue with a grip; each grip is tested once."""
        if number not in self.faults:
            fault = None
            if self._ahead:
                grasp = self._taker, self._thing, inverse(grip.T_pinch_in_thing), self._taker.ready
                fault = self._ahead[0].fault(self._bench, self._cast, *grasp, self._ahead[1:])
            self.faults[number] = fault
        return self.faults[number] is None


def _taking_grips(bench: Bench, cast: Cast, taker: Hand, thing: str, ahead: Sequence[Skill]) -> _TakingGrips:
    """Return the taking grips, which all searches share while nothing moves: `faults` holds for every meeting."""
    key = ("taking grips", taker.side, thing, tuple(ahead))
    return bench.cached(key, lambda: _TakingGrips(bench, cast, taker, thing, ahead))


def _within_reach(
    giver: Hand, taker: Hand, T_giving: Array, grips: Iterator[tuple[int, Grip]], poses: _Poses
) -> Iterator[tuple[int, Grip, Array]]:
    """Yield each grip with those of a thing's poses (n, 4, 4) in `world` at which both hands may reach the thing."""
    while batch := list(itertools.islice(grips, _BATCH_SIZE)):
        T, k = poses.of([grip for _, grip in batch])
        T_grips = np.array([grip.T_pinch_in_thing for _, grip in batch])
        reached = taker.may_reach(T @ T_grips[k])
        reached[reached] = giver.may_reach(T[reached] @ T_giving, PASSING)
        T, k = T[reached], k[reached]
        for number in np.unique(k):
            yield *batch[number], T[k == number]


def _reached(giver: Hand, taker: Hand, T_giving: Array, T_taking: Array, grip: Grip) -> _Meeting | None:
    """Return the meeting with the pinch frames at poses (4, 4) in `world`; None if an arm does not reach its pose."""
    if not can_point(T_giving, giver.arm.T_base_in_world) or not can_point(T_taking, taker.arm.T_base_in_world):
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
    return _Meeting(grip, min(grip.opening + grip.clearance, taker.max_opening), giving, before, taking)


def _is_free(bench: Bench, giver: Hand, taker: Hand, held: Held, meeting: _Meeting) -> bool:
    """Return whether the hands touch nothing at a meeting but the thing between their fingers."""
    if bench.touched(giver, meeting.giver_joints, giver.opening, Load(held.thing, held.T_thing_in_pinch)):
        return False
    qpos = bench.posed_qpos(giver, meeting.giver_joints, giver.opening, held)
    touched, opening = bench.obstacles.touched, meeting.opening
    blocked = touched(qpos, taker.number, meeting.taker_joints, opening, between=held.thing)
    return not blocked and not touched(qpos, taker.number, meeting.approach_joints, opening)


@dataclass(frozen=True)
class _Attitude:
    """Orientation of a thing in which two hands grasp it from their own sides.

    Attributes:
        R_thing: rotation (3, 3) from the thing's frame to a frame whose first axis leads from the giving hand to the
            taking hand, and whose second axis points along both hands.
        apart: distance between hands that point in similar directions, m; infinite for other hands.
        facing: whether the hands face each other, so that the thing may roll about the line between them.
    """

    R_thing: Array
    apart: float
    facing: bool


@dataclass(frozen=True)
class _Poses:
    """Poses of a thing at which each hand comes from its own side, and both as steeply from above as possible.

    Attributes:
        across: direction (3,) from the giving to the taking hand, in `world`.
        apart: least and largest `apart` of an attitude, m.
        places: of the thing's origin (n, 3), in `world`, m.
        attitude: returns the thing's attitude for a taking grip.
    """

    across: Array
    apart: tuple[float, float]
    places: Array
    attitude: Callable[[Grip], _Attitude | None]

    def of(self, grips: Sequence[Grip]) -> tuple[Array, NDArray[np.intp]]:
        """Return the poses (n, 4, 4) in `world` for taking grips, in their order, and the number of each one's grip."""
        attitudes, (least, most) = [self.attitude(grip) for grip in grips], self.apart
        fitting = [(k, found) for k, found in enumerate(attitudes) if found and least <= found.apart <= most]
        numbers = np.array([k for k, _ in fitting], np.intp)
        R = self._rolled @ np.array([found.R_thing for _, found in fitting]).reshape(-1, 1, 3, 3)
        rolls = np.array([found.facing for _, found in fitting], bool)[:, None] | (np.arange(len(_ROLLS)) == 0)
        T = np.zeros((np.count_nonzero(rolls), len(self.places), 4, 4))
        T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R[rolls][:, None], self.places, 1.0
        return T.reshape(-1, 4, 4), numbers[np.nonzero(rolls)[0]].repeat(len(self.places))

    @functools.cached_property
    def _rolled(self) -> Array:
        down = np.array((0.0, 0.0, -1.0))
        world = np.column_stack([self.across, down, np.cross(self.across, down)])
        return np.array([rotation_from_vector(self.across * roll) @ world for roll in _ROLLS])


def _attitude(T_giving: Array, T_taking: Array) -> _Attitude | None:
    """Return the attitude for two pinch frames (4, 4) in the thing's frame; None if the hands would collide."""
    giving, taking = T_giving[:3, 2], T_taking[:3, 2]
    angle = math.acos(max(-1.0, min(1.0, float(giving @ taking))))
    first, apart = giving - taking, math.inf
    if angle < _MIN_ANGLE:
        first = T_taking[:3, 3] - T_giving[:3, 3]
        apart = float(np.linalg.norm(first))
        if apart < _MIN_APART:
            return None
    first = first / np.linalg.norm(first)
    second = giving + taking
    if angle > _FACING_ANGLE:
        # The hands face each other, so any direction across the line may point down; the thing's own z axis is tried
        # first.
        second = np.array((0.0, 0.0, -1.0)) if abs(first[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    second = second - (second @ first) * first
    length = np.linalg.norm(second)
    if length < 0.1:
        return None
    second = second / length
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    R_thing = np.array([first, second, (b * z - c * y, c * x - a * z, a * y - b * x)])
    return _Attitude(R_thing, apart, angle > _FACING_ANGLE)
