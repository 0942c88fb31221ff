from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...files.documents.units import Distance
from ...geometry.se3 import Array, invert_pose, pose
from .common_motions import CLOSING_TICKS, release_and_retreat, rest_segment
from .grasp_candidates import GraspCandidate, is_orientation_plausible
from .hand import WAYPOINT_TOLERANCE, Hand, HeldObject
from .planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .skill import Skill

_APPROACH_LENGTH = 0.08  # m, length of each hand's straight approach
_MIN_GRASP_DISTANCE = 0.12  # m, between the two grasps
_MAX_CANDIDATES = 24  # reachable grasps of each hand that are compared

_LIFT_SPEED = 0.10  # m/s


class BimanualLift(Skill):
    """Grasp an object at two places, one with each hand, and lift it level, `by` m."""

    TYPICAL_SECONDS: ClassVar[float] = 3.7
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    HANDS: ClassVar[int] = 2
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    thing: str
    by: Distance = 0.10

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill.run`."""
        thing = roles.object_of(self.thing)
        hand_a, hand_b = context.hands[:2]
        found = self._find_grasp_pair(context, hand_a, hand_b, thing)
        openings = {hand: min(grip.opening + grip.clearance, hand.max_opening) for hand, grip, *_ in found}
        for hand, _, before, _ in found:
            yield context.make_segment(
                {hand: context.plan_free_path(hand, before, openings[hand])}, {hand: FingerTarget(openings[hand])}
            )
        T_thing = context.world.pose(thing)
        lines = {hand: context.plan_line(hand, T_thing @ grip.T_pinch_in_thing) for hand, grip, *_ in found}
        yield context.make_segment(lines)
        closing = {hand: FingerTarget(grip.opening, grip.force) for hand, grip, *_ in found}
        yield context.make_segment({hand: context.hold_still_motion(hand, CLOSING_TICKS) for hand in closing}, closing)
        yield rest_segment(context)
        holders = context.world.holding_sides(thing)
        if not {hand.side for hand in closing} <= holders:
            for hand, grip, *_ in found:
                yield from release_and_retreat(context, hand, grip.clearance)
            raise SkillFailedError(FailureCause.SLIPPED, f"the {thing} is not in both hands")
        for hand in closing:
            hand.held_object = HeldObject(thing, invert_pose(context.T_pinch(hand)) @ context.world.pose(thing))
        up = {}
        for hand in closing:
            T_up = hand.pinch_pose(hand.joints)
            T_up[2, 3] += self.by
            up[hand] = context.plan_line(hand, T_up, _LIFT_SPEED)
        yield context.make_segment(up)
        for hand in closing:
            context.measure_held_object(hand)

    def _find_grasp_pair(
        self, context: PlanningContext, hand_a: Hand, hand_b: Hand, thing: str
    ) -> list[tuple[Hand, GraspCandidate, Array, Array]]:
        """Return the most distant free grasps: each hand, its grasp, and joints before and at it."""
        reached = {hand: list(self._reachable_grasps(context, hand, thing)) for hand in (hand_a, hand_b)}
        pairs = sorted(
            itertools.product(*reached.values()),
            key=lambda pair: (
                -float(np.linalg.norm(pair[0][1].T_pinch_in_thing[:3, 3] - pair[1][1].T_pinch_in_thing[:3, 3]))
            ),
        )
        for first, second in pairs:
            apart = _pinch_position(first[1]) - _pinch_position(second[1])
            if float(np.linalg.norm(apart)) < _MIN_GRASP_DISTANCE:
                break
            qpos = context.qpos_with_hand(first[0], first[3], first[1].opening, None)
            if (
                context.collision_checker.find_contact(
                    qpos, second[0].number, second[3], second[1].opening, grasped=thing
                )
                is None
            ):
                return [first, second]
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no two places at which both hands can take the {thing}")

    def _reachable_grasps(
        self, context: PlanningContext, hand: Hand, thing: str
    ) -> Iterator[tuple[Hand, GraspCandidate, Array, Array]]:
        T_thing, number = context.world.pose(thing), 0
        for grip in context.grasp_candidates(thing, hand.max_opening):
            T_at = T_thing @ grip.T_pinch_in_thing
            if not is_orientation_plausible(T_at, hand.arm.T_base_in_world):
                continue
            at = hand.solve_ik(T_at, (hand.ready_joints,))
            before = (
                None
                if at is None
                else hand.solve_ik(T_at @ pose((0.0, 0.0, -_APPROACH_LENGTH)), (at,), WAYPOINT_TOLERANCE)
            )
            if at is None or before is None:
                continue
            opening = min(grip.opening + grip.clearance, hand.max_opening)
            if context.find_contact(hand, at, opening, grasped=thing) or context.find_contact(hand, before, opening):
                continue
            T_up = T_at.copy()
            T_up[2, 3] += self.by
            if hand.solve_ik(T_up, (at,)) is None:
                continue
            number += 1
            yield hand, grip, before, at
            if number == _MAX_CANDIDATES:
                return


def _pinch_position(candidate: GraspCandidate) -> Array:
    position: Array = candidate.T_pinch_in_thing[:3, 3]
    return position
