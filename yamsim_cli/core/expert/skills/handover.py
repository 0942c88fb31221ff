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

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...files.documents.units import Distance
from ...geometry.se3 import Array, inverse, pose, rotation_from_vector, rotation_z
from ..planning.collision_checker import AttachedObject
from .common_motions import close_fingers_on, release_and_retreat, rest_segment
from .grasp_candidates import GraspCandidate, is_orientation_plausible
from .hand import WAYPOINT_TOLERANCE, Hand, HeldObject
from .planning_context import CachedIterable, FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .skill import Skill, preference_levels, require_holding_hand

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
class _HandoverPose:
    """Grip and joints of both hands at a handover.

    Attributes:
        grip: of the taking hand.
        opening: of each of its fingers before it closes, m.
        giver_joints: of the giving arm (dof,), rad.
        approach_joints: of the taking arm before the straight approach (dof,), rad.
        taker_joints: of the taking arm at the thing (dof,), rad.
    """

    grip: GraspCandidate
    opening: float
    giver_joints: Array
    approach_joints: Array
    receiver_joints: Array


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
    PLACES: ClassVar[tuple[tuple[float, float, float, float], ...]] = _MEETINGS
    thing: str
    to: Literal["left", "right", "first", "second", "other"] = "other"
    height: Distance = 0.22

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill`."""
        thing = roles.object_of(self.thing)
        giver = require_holding_hand(context, thing, "handed over")
        if context.side_of(self.to) == giver.side:
            return
        taker = next(hand for hand in context.hands if hand is not giver)
        meeting = self._meeting(context, roles, giver, taker, next_skills)
        held = context.update_held(giver)
        load = AttachedObject(thing, held.T_thing_in_pinch)
        yield context.make_segment({giver: context.plan_free_path(giver, meeting.giver_joints, load=load)})
        path = context.plan_free_path(taker, meeting.approach_joints, meeting.opening)
        yield context.make_segment({taker: path}, {taker: FingerTarget(meeting.opening)})
        T_grip = context.world.pose(thing) @ meeting.grip.T_pinch_in_thing
        yield context.make_segment({taker: context.plan_line(taker, T_grip)})
        yield from close_fingers_on(context, taker, meeting.grip)
        if taker.side not in context.world.holding_sides(thing):
            yield from release_and_retreat(context, taker, meeting.grip.clearance)
            raise SkillFailedError(FailureCause.SLIPPED, f"the {thing} is not between the {taker.side} hand's fingers")
        taker.held = HeldObject(thing, inverse(context.T_pinch(taker)) @ context.world.pose(thing))
        yield from release_and_retreat(context, giver, context.release_clearance(thing))
        yield rest_segment(context)
        context.update_held(taker)

    def infeasibility(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        joints: Array,
        next_skills: Sequence[Skill] = (),
    ) -> str | None:
        """See `Skill`."""
        if roles.object_of(self.thing) != thing or context.side_of(self.to) == hand.side:
            return None
        taker = next(other for other in context.hands if other is not hand)
        searches = context.cached(("searches", self, hand.side, tuple(next_skills)), lambda: itertools.count(1))
        if next(searches) > _MAX_SEARCHES:
            return f"no place found where the {taker.side} hand can take it"
        if (
            self._meeting_before(context, roles, hand, taker, HeldObject(thing, T_thing_in_pinch), next_skills)
            is not None
        ):
            return None
        faults = list(_receiver_grasps(context, roles, taker, thing, next_skills).faults.values())
        return faults[-1] if faults and all(faults) else f"no place where the {taker.side} hand can take it"

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Handover:
        """See `Skill`: the line from hand to hand may be turned relative to the line between the bases."""
        return _TurnedHandover.model_construct(**dict(self))

    def _meeting(
        self, context: PlanningContext, roles: RoleAssignment, giver: Hand, receiver: Hand, next_skills: Sequence[Skill]
    ) -> _HandoverPose:
        """Return the first meeting that leaves the next skills possible; else the first reachable meeting."""
        held = context.update_held(giver)
        for following in (*preference_levels(next_skills, context, roles), ()):
            for skill in (self, self.without_preferences(context, roles)):
                if (found := skill._meeting_before(context, roles, giver, receiver, held, following)) is not None:
                    return found
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no place where both hands reach the {held.thing}")

    def _meeting_before(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        giver: Hand,
        receiver: Hand,
        held: HeldObject,
        next_skills: Sequence[Skill],
    ) -> _HandoverPose | None:
        """Return the first meeting without contacts that both hands reach and that leaves skills possible."""
        grips = _receiver_grasps(context, roles, receiver, held.thing, next_skills)
        # The first search tests a grip only if hands can meet with it. Later searches profit from every tested grip.
        check_first = bool(grips.faults)
        T_giving = inverse(held.T_thing_in_pinch)
        bases = [hand.arm.T_base_in_world[:3, 3] for hand in (giver, receiver)]
        middle, across = (bases[0] + bases[1]) / 2, bases[1] - bases[0]
        across = across / np.linalg.norm(across)
        height = float(context.world.aabb(TABLE)[1][2]) + self.height
        attitude = functools.cache(lambda grip: _handover_orientation(T_giving, grip.T_pinch_in_thing))
        for least, most, lower, turn in self.PLACES:
            places = [np.array((middle[0] + ahead, middle[1], height - lower)) for ahead in _MEETING_X]
            poses = _HandoverPoseSampler(rotation_z(turn) @ across, (least, most), np.array(places), attitude)
            for number, grip, T_things in _reachable_poses(giver, receiver, T_giving, grips.open(), poses):
                if check_first and not grips.suits(number, grip):
                    continue
                for T_thing in T_things:
                    meeting = _solve_handover(
                        giver, receiver, T_thing @ T_giving, T_thing @ grip.T_pinch_in_thing, grip
                    )
                    if meeting is None:
                        continue
                    if not grips.suits(number, grip):
                        break
                    if _is_free(context, giver, receiver, held, meeting):
                        return meeting
        return None


class _TurnedHandover(Handover):
    """A handover in which the line from hand to hand may be turned."""

    PLACES: ClassVar[tuple[tuple[float, float, float, float], ...]] = _TURNED_MEETINGS

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Handover:
        """See `Skill`."""
        return self


class _ReceiverGrasps:
    """Grips by which a hand may take a thing, the most reliable first.

    Attributes:
        faults: number of each tested grip -> why the skills ahead would fail with it; None if they would not.
    """

    def __init__(
        self, context: PlanningContext, roles: RoleAssignment, receiver: Hand, thing: str, next_skills: Sequence[Skill]
    ) -> None:
        self._context, self._roles, self._receiver, self._thing, self._next_skills = (
            context,
            roles,
            receiver,
            thing,
            next_skills,
        )
        self._grips = CachedIterable(context.grasp_candidates(thing, receiver.max_opening))
        self.faults: dict[int, str | None] = {}

    def open(self) -> Iterator[tuple[int, GraspCandidate]]:
        """Yield the number and the grip of all that are untested or suitable."""
        return ((number, grip) for number, grip in enumerate(self._grips) if not self.faults.get(number))

    def suits(self, number: int, grip: GraspCandidate) -> bool:
        """Return whether the skills ahead can continue with a grip; each grip is tested once."""
        if number not in self.faults:
            fault = None
            if self._next_skills:
                grasp = self._receiver, self._thing, inverse(grip.T_pinch_in_thing), self._receiver.ready_joints
                fault = self._next_skills[0].infeasibility(self._context, self._roles, *grasp, self._next_skills[1:])
            self.faults[number] = fault
        return self.faults[number] is None


def _receiver_grasps(
    context: PlanningContext, roles: RoleAssignment, receiver: Hand, thing: str, next_skills: Sequence[Skill]
) -> _ReceiverGrasps:
    """Return the taking grips, which all searches share while nothing moves: `faults` holds for every meeting."""
    key = ("taking grips", receiver.side, thing, tuple(next_skills))
    return context.cached(key, lambda: _ReceiverGrasps(context, roles, receiver, thing, next_skills))


def _reachable_poses(
    giver: Hand,
    receiver: Hand,
    T_giving: Array,
    grips: Iterator[tuple[int, GraspCandidate]],
    poses: _HandoverPoseSampler,
) -> Iterator[tuple[int, GraspCandidate, Array]]:
    """Yield each grip with those of a thing's poses (n, 4, 4) in `world` at which both hands may reach the thing."""
    while batch := list(itertools.islice(grips, _BATCH_SIZE)):
        T, k = poses.of([grip for _, grip in batch])
        T_grips = np.array([grip.T_pinch_in_thing for _, grip in batch])
        reached = receiver.maybe_reachable(T @ T_grips[k])
        reached[reached] = giver.maybe_reachable(T[reached] @ T_giving, WAYPOINT_TOLERANCE)
        T, k = T[reached], k[reached]
        for number in np.unique(k):
            yield *batch[number], T[k == number]


def _solve_handover(
    giver: Hand, receiver: Hand, T_giving: Array, T_taking: Array, grip: GraspCandidate
) -> _HandoverPose | None:
    """Return the meeting with the pinch frames at poses (4, 4) in `world`; None if an arm does not reach its pose."""
    if not is_orientation_plausible(T_giving, giver.arm.T_base_in_world) or not is_orientation_plausible(
        T_taking, receiver.arm.T_base_in_world
    ):
        return None
    taking = receiver.solve_ik(T_taking, (receiver.ready_joints,))
    if taking is None:
        return None
    giving = giver.solve_ik(T_giving, (giver.joints, giver.ready_joints), WAYPOINT_TOLERANCE)
    if giving is None:
        return None
    before = receiver.solve_ik(T_taking @ pose((0.0, 0.0, -_APPROACH)), (taking,), WAYPOINT_TOLERANCE)
    if before is None:
        return None
    return _HandoverPose(grip, min(grip.opening + grip.clearance, receiver.max_opening), giving, before, taking)


def _is_free(context: PlanningContext, giver: Hand, receiver: Hand, held: HeldObject, meeting: _HandoverPose) -> bool:
    """Return whether the hands touch nothing at a meeting but the thing between their fingers."""
    if context.find_contact(
        giver, meeting.giver_joints, giver.opening, AttachedObject(held.thing, held.T_thing_in_pinch)
    ):
        return False
    qpos = context.qpos_with_hand(giver, meeting.giver_joints, giver.opening, held)
    touched, opening = context.collision_checker.find_contact, meeting.opening
    blocked = touched(qpos, receiver.number, meeting.receiver_joints, opening, grasped=held.thing)
    return not blocked and not touched(qpos, receiver.number, meeting.approach_joints, opening)


@dataclass(frozen=True)
class _HandoverOrientation:
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
class _HandoverPoseSampler:
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
    attitude: Callable[[GraspCandidate], _HandoverOrientation | None]

    def of(self, grips: Sequence[GraspCandidate]) -> tuple[Array, NDArray[np.intp]]:
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


def _handover_orientation(T_giving: Array, T_taking: Array) -> _HandoverOrientation | None:
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
    return _HandoverOrientation(R_thing, apart, angle > _FACING_ANGLE)
