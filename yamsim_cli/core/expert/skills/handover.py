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
from ...geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_z
from ..planning.collision_checker import AttachedObject
from .common_motions import close_fingers_on, release_and_retreat, rest_segment
from .grasp_candidates import GraspCandidate, is_orientation_plausible
from .hand import WAYPOINT_TOLERANCE, Hand, HeldObject
from .planning_context import CachedIterable, FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .skill import Skill, preference_levels, require_holding_hand

_APPROACH_LENGTH = 0.08  # m, length of the receiver's straight approach

_HANDOVER_X = (0.32, 0.26, 0.38, 0.44)  # m in front of the midpoint between the bases, in the order tried

_MIN_FINGER_ANGLE = math.radians(50)  # rad, hands whose fingers' directions differ by less collide unless side by side
# rad, hands whose directions differ by more face each other, and the object may roll about the line between them
_FACING_ANGLE = math.radians(165)
_MIN_HAND_DISTANCE = 0.07  # m, between hands that come from the same side: their fingers just pass each other
_ROOMY_DISTANCE = 0.13  # m, between hands whose fingers have room between them
# Where handovers are searched, in the order tried: least and largest distance between the hands, m (infinite unless
# they come from the same side); depth below `height`, m; angle, rad, from the line between bases to that between hands.
# Lower places, which hands reach from above, come last.
_SEARCH_ORDER = (
    (_ROOMY_DISTANCE, math.inf, 0.0, 0.0),
    (_MIN_HAND_DISTANCE, _ROOMY_DISTANCE, 0.0, 0.0),
    *((_MIN_HAND_DISTANCE, math.inf, lower, 0.0) for lower in (0.06, 0.12)),
)
_OBJECT_YAW_ANGLES = tuple(
    math.radians(angle) for angle in (30, -30, 60, -60)
)  # rad, between the lines, in the order tried
_TURNED_SEARCH_ORDER = (
    *_SEARCH_ORDER,
    *((_MIN_HAND_DISTANCE, math.inf, lower, turn) for turn in _OBJECT_YAW_ANGLES for lower in (0.0, 0.06)),
)

# Giver's grasps for which `Handover.infeasibility_reason` searches a handover while nothing moves. A search without
# success takes half a second, and an object in a pile has hundreds of grasps.
_MAX_POSE_SEARCHES = 24

_BATCH_SIZE = 256  # grasps whose poses are tested in one call; the fixed cost of a call equals the cost of 200 poses

# rad, rolls of the object about the line between hands that face each other, in the order tried
_OBJECT_ROLL_ANGLES = tuple(math.radians(angle) for angle in (0, 90, 180, -90))


@dataclass(frozen=True)
class _HandoverPose:
    """The receiver's grasp, and joints (dof,) of both arms at a handover, rad.

    Attributes:
        opening: of each of the receiver's fingers before they close, m.
        approach_joints: of the receiver's arm before the straight approach.
    """

    candidate: GraspCandidate
    opening: float
    giver_joints: Array
    approach_joints: Array
    receiver_joints: Array


class Handover(Skill):
    """Move an object to `height` m over the table, where both hands reach it, grasp it with hand `to`, and open the
    other.
    """

    TYPICAL_SECONDS: ClassVar[float] = 4.7
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    HANDS: ClassVar[int] = 2
    HANDS_OVER: ClassVar[bool] = True
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = True
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    PLACES: ClassVar[tuple[tuple[float, float, float, float], ...]] = _SEARCH_ORDER
    thing: str
    to: Literal["left", "right", "first", "second", "other"] = "other"
    height: Distance = 0.22

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if the receiver holds the object already; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        giver = require_holding_hand(context, thing, "handed over")
        if context.side_of(self.to) == giver.side:
            return
        receiver = next(hand for hand in context.hands if hand is not giver)
        handover = self._find_handover(context, roles, giver, receiver, next_skills)
        held = context.measure_held_object(giver)
        load = AttachedObject(thing, held.T_thing_in_pinch)
        yield context.make_segment({giver: context.plan_free_path(giver, handover.giver_joints, attached=load)})
        path = context.plan_free_path(receiver, handover.approach_joints, handover.opening)
        yield context.make_segment({receiver: path}, {receiver: FingerTarget(handover.opening)})
        T_grip = context.world.pose(thing) @ handover.candidate.T_pinch_in_thing
        yield context.make_segment({receiver: context.plan_line(receiver, T_grip)})
        yield from close_fingers_on(context, receiver, handover.candidate)
        if receiver.side not in context.world.holding_sides(thing):
            yield from release_and_retreat(context, receiver, handover.candidate.clearance)
            raise SkillFailedError(
                FailureCause.SLIPPED, f"the {thing} is not between the {receiver.side} hand's fingers"
            )
        receiver.held_object = HeldObject(thing, invert_pose(context.T_pinch(receiver)) @ context.world.pose(thing))
        yield from release_and_retreat(context, giver, context.release_clearance(thing))
        yield rest_segment(context)
        context.measure_held_object(receiver)

    def infeasibility_reason(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        joints: Array,
        next_skills: Sequence[Skill] = (),
    ) -> str | None:
        """See `Skill.infeasibility_reason`."""
        if roles.object_of(self.thing) != thing or context.side_of(self.to) == hand.side:
            return None
        receiver = next(other for other in context.hands if other is not hand)
        searches = context.compute_once(("searches", self, hand.side, tuple(next_skills)), lambda: itertools.count(1))
        if next(searches) > _MAX_POSE_SEARCHES:
            return f"no place found where the {receiver.side} hand can take it"
        if (
            self._find_handover_for(context, roles, hand, receiver, HeldObject(thing, T_thing_in_pinch), next_skills)
            is not None
        ):
            return None
        faults = list(_receiver_grasps(context, roles, receiver, thing, next_skills).faults.values())
        return faults[-1] if faults and all(faults) else f"no place where the {receiver.side} hand can take it"

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Handover:
        """Return a handover whose line from hand to hand may be turned from that between the bases."""
        return _TurnedHandover.model_construct(**dict(self))

    def _find_handover(
        self, context: PlanningContext, roles: RoleAssignment, giver: Hand, receiver: Hand, next_skills: Sequence[Skill]
    ) -> _HandoverPose:
        """Return the first handover that leaves the next skills possible; else the first reachable one."""
        held = context.measure_held_object(giver)
        for following in (*preference_levels(next_skills, context, roles), ()):
            for skill in (self, self.without_preferences(context, roles)):
                if (found := skill._find_handover_for(context, roles, giver, receiver, held, following)) is not None:
                    return found
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no place where both hands reach the {held.thing}")

    def _find_handover_for(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        giver: Hand,
        receiver: Hand,
        held: HeldObject,
        next_skills: Sequence[Skill],
    ) -> _HandoverPose | None:
        grips = _receiver_grasps(context, roles, receiver, held.thing, next_skills)
        # The first search tests a grasp only if hands can reach a handover with it. Later searches test grasps first.
        check_first = bool(grips.faults)
        T_giving = invert_pose(held.T_thing_in_pinch)
        bases = [hand.arm.T_base_in_world[:3, 3] for hand in (giver, receiver)]
        # Level, also between bases of unequal height: hands meet with the object upright.
        middle, across = (bases[0] + bases[1]) / 2, (bases[1] - bases[0]) * (1.0, 1.0, 0.0)
        across = across / np.linalg.norm(across)
        height = float(context.world.aabb(TABLE)[1][2]) + self.height
        attitude = functools.cache(lambda grip: _handover_orientation(T_giving, grip.T_pinch_in_thing))
        for least, most, lower, turn in self.PLACES:
            places = [np.array((middle[0] + ahead, middle[1], height - lower)) for ahead in _HANDOVER_X]
            poses = _HandoverPoseSampler(rotation_z(turn) @ across, (least, most), np.array(places), attitude)
            for number, grip, T_things in _reachable_poses(giver, receiver, T_giving, grips.iterate_suitable(), poses):
                if check_first and not grips.is_suitable(number, grip):
                    continue
                for T_thing in T_things:
                    handover = _solve_handover(
                        giver, receiver, T_thing @ T_giving, T_thing @ grip.T_pinch_in_thing, grip
                    )
                    if handover is None:
                        continue
                    if not grips.is_suitable(number, grip):
                        break
                    if _is_contact_free(context, giver, receiver, held, handover):
                        return handover
        return None


class _TurnedHandover(Handover):
    PLACES: ClassVar[tuple[tuple[float, float, float, float], ...]] = _TURNED_SEARCH_ORDER

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Handover:
        return self


class _ReceiverGrasps:
    """Grasp candidates of the receiver, the most reliable first.

    `faults` has, for each tested candidate's index, why the next skills would fail with it.
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
        self._candidates = CachedIterable(context.grasp_candidates(thing, receiver.max_opening))
        self.faults: dict[int, str | None] = {}

    def iterate_suitable(self) -> Iterator[tuple[int, GraspCandidate]]:
        return ((number, grip) for number, grip in enumerate(self._candidates) if not self.faults.get(number))

    def is_suitable(self, number: int, candidate: GraspCandidate) -> bool:
        if number not in self.faults:
            fault = None
            if self._next_skills:
                grasp = (
                    self._receiver,
                    self._thing,
                    invert_pose(candidate.T_pinch_in_thing),
                    self._receiver.ready_joints,
                )
                fault = self._next_skills[0].infeasibility_reason(
                    self._context, self._roles, *grasp, self._next_skills[1:]
                )
            self.faults[number] = fault
        return self.faults[number] is None


def _receiver_grasps(
    context: PlanningContext, roles: RoleAssignment, receiver: Hand, thing: str, next_skills: Sequence[Skill]
) -> _ReceiverGrasps:
    """Return the receiver's candidates, whose test results all searches share while nothing moves."""
    key = ("taking grips", receiver.side, thing, tuple(next_skills))
    return context.compute_once(key, lambda: _ReceiverGrasps(context, roles, receiver, thing, next_skills))


def _reachable_poses(
    giver: Hand,
    receiver: Hand,
    T_giving: Array,
    grips: Iterator[tuple[int, GraspCandidate]],
    poses: _HandoverPoseSampler,
) -> Iterator[tuple[int, GraspCandidate, Array]]:
    """Yield each candidate with the object's poses (n, 4, 4) at which both hands may reach it."""
    while batch := list(itertools.islice(grips, _BATCH_SIZE)):
        T, k = poses.poses_for([grip for _, grip in batch])
        T_grips = np.array([grip.T_pinch_in_thing for _, grip in batch])
        reached = receiver.may_be_reachable(T @ T_grips[k])
        reached[reached] = giver.may_be_reachable(T[reached] @ T_giving, WAYPOINT_TOLERANCE)
        T, k = T[reached], k[reached]
        for number in np.unique(k):
            yield *batch[number], T[k == number]


def _solve_handover(
    giver: Hand, receiver: Hand, T_giving: Array, T_receiving: Array, candidate: GraspCandidate
) -> _HandoverPose | None:
    if not is_orientation_plausible(T_giving, giver.arm.T_base_in_world) or not is_orientation_plausible(
        T_receiving, receiver.arm.T_base_in_world
    ):
        return None
    receiving = receiver.solve_ik(T_receiving, (receiver.ready_joints,))
    if receiving is None:
        return None
    giving = giver.solve_ik(T_giving, (giver.joints, giver.ready_joints), WAYPOINT_TOLERANCE)
    if giving is None:
        return None
    before = receiver.solve_ik(T_receiving @ pose((0.0, 0.0, -_APPROACH_LENGTH)), (receiving,), WAYPOINT_TOLERANCE)
    if before is None:
        return None
    return _HandoverPose(
        candidate, min(candidate.opening + candidate.clearance, receiver.max_opening), giving, before, receiving
    )


def _is_contact_free(
    context: PlanningContext, giver: Hand, receiver: Hand, held: HeldObject, handover: _HandoverPose
) -> bool:
    if context.find_contact(
        giver, handover.giver_joints, giver.opening, AttachedObject(held.thing, held.T_thing_in_pinch)
    ):
        return False
    qpos = context.qpos_with_hand(giver, handover.giver_joints, giver.opening, held)
    touched, opening = context.collision_checker.find_contact, handover.opening
    blocked = touched(qpos, receiver.number, handover.receiver_joints, opening, grasped=held.thing)
    return not blocked and not touched(qpos, receiver.number, handover.approach_joints, opening)


@dataclass(frozen=True)
class _HandoverOrientation:
    """Orientation of an object in which two hands grasp it from their own sides.

    Attributes:
        R_thing_in_handover: rotation from the object's frame to the handover frame. Its first axis leads from
            the giver to the receiver, and its second axis points along both hands.
        hand_distance: distance between hands that point in similar directions, m; infinite for other hands.
        facing: whether the hands face each other, so that the object may roll about the line between them.
    """

    R_thing_in_handover: Array
    hand_distance: float
    facing: bool


@dataclass(frozen=True)
class _HandoverPoseSampler:
    """Poses of an object at which each hand comes from its own side, and both as steeply from above as possible.

    Attributes:
        across: direction (3,) from the giver to the receiver, in `world`.
        hand_distances: least and largest `hand_distance` of an orientation, m.
        places: of the object's origin (n, 3), in `world`, m.
        orientation_for: orientation for a grasp candidate of the receiver.
    """

    across: Array
    hand_distances: tuple[float, float]
    places: Array
    orientation_for: Callable[[GraspCandidate], _HandoverOrientation | None]

    def poses_for(self, grips: Sequence[GraspCandidate]) -> tuple[Array, NDArray[np.intp]]:
        """Return poses (n, 4, 4) in `world` for candidates, and the index of each pose's candidate."""
        attitudes, (least, most) = [self.orientation_for(grip) for grip in grips], self.hand_distances
        fitting = [(k, found) for k, found in enumerate(attitudes) if found and least <= found.hand_distance <= most]
        numbers = np.array([k for k, _ in fitting], np.intp)
        R = self._rolled_frames @ np.array([found.R_thing_in_handover for _, found in fitting]).reshape(-1, 1, 3, 3)
        rolls = np.array([found.facing for _, found in fitting], bool)[:, None] | (
            np.arange(len(_OBJECT_ROLL_ANGLES)) == 0
        )
        T = np.zeros((np.count_nonzero(rolls), len(self.places), 4, 4))
        T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R[rolls][:, None], self.places, 1.0
        return T.reshape(-1, 4, 4), numbers[np.nonzero(rolls)[0]].repeat(len(self.places))

    @functools.cached_property
    def _rolled_frames(self) -> Array:
        down = np.array((0.0, 0.0, -1.0))
        world = np.column_stack([self.across, down, np.cross(self.across, down)])
        return np.array([rotation_from_vector(self.across * roll) @ world for roll in _OBJECT_ROLL_ANGLES])


def _handover_orientation(T_giving: Array, T_receiving: Array) -> _HandoverOrientation | None:
    """Return the orientation for two pinch frames in the object's frame; None if the hands would collide."""
    giving, receiving = T_giving[:3, 2], T_receiving[:3, 2]
    angle = math.acos(max(-1.0, min(1.0, float(giving @ receiving))))
    first, apart = giving - receiving, math.inf
    if angle < _MIN_FINGER_ANGLE:
        first = T_receiving[:3, 3] - T_giving[:3, 3]
        apart = float(np.linalg.norm(first))
        if apart < _MIN_HAND_DISTANCE:
            return None
    first = first / np.linalg.norm(first)
    second = giving + receiving
    if angle > _FACING_ANGLE:
        # Hands that face each other leave free which direction across their line points down; try the object's z first.
        second = np.array((0.0, 0.0, -1.0)) if abs(first[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    second = second - (second @ first) * first
    length = np.linalg.norm(second)
    if length < 0.1:
        return None
    second = second / length
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    R_thing_in_handover = np.array([first, second, (b * z - c * y, c * x - a * z, a * y - b * x)])
    return _HandoverOrientation(R_thing_in_handover, apart, angle > _FACING_ANGLE)
