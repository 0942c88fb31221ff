from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...files.documents.units import Distance
from ...geometry.se3 import Array, invert_pose, pose
from ..planning.collision_checker import AttachedObject
from .common_motions import close_fingers_on, park_free_hands, release_and_retreat
from .grasp_candidates import GraspCandidate, is_orientation_plausible
from .hand import PREFERRED_JOINT_MARGIN, WAYPOINT_TOLERANCE, Hand, HeldObject
from .planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .skill import ArmSelector, Skill, find_holding_hand, preference_levels

_APPROACH_DISTANCES = (0.09, 0.05)  # m, lengths of the straight approach; the shorter one is for tight places

# Least distance from joint limits (rad), and whether hands may tilt at waypoints, in the order tried.
_PLANNING_LIMITS = ((PREFERRED_JOINT_MARGIN, False), (0.0, False), (0.0, True))


@dataclass(frozen=True)
class ReachableGrasp:
    """A grasp candidate that a hand can reach now.

    Attributes:
        approach_joints, grasp_joints: joints (dof,) before the straight approach and at the grasp, rad.
        opening: of each finger during the approach, m.
    """

    candidate: GraspCandidate
    approach_joints: Array
    grasp_joints: Array
    opening: float


class Pick(Skill):
    """Grasp an object and `lift` it (m), with an arm and a grasp that leave the next skills possible."""

    TYPICAL_SECONDS: ClassVar[float] = 2.7
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    # Whether each motion waits until the arm has reached the end of the previous motion.
    WAIT_FOR_REST: ClassVar[bool] = True
    thing: str
    arm: ArmSelector = "any"
    lift: Distance = 0.06

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if a hand holds the object already; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        if find_holding_hand(context, thing) is not None:
            return
        places = next_skills[0].approximate_targets(context, roles, thing) if next_skills else ()
        reasons: dict[str, int] = {}
        for following, (margin, tilts) in itertools.product(
            preference_levels(next_skills, context, roles), _PLANNING_LIMITS
        ):
            reasons.clear()
            for hand in self._hands_by_reach(context, thing, places):
                with context.planning_limits(margin, tilts):
                    found = self._find_grasp(context, roles, hand, thing, following, reasons)
                if found is not None:
                    yield from park_free_hands(context, hand)
                    yield from self.grasp_and_lift(context, hand, thing, found)
                    return
        if not reasons:
            low, high = context.world.local_box(thing)
            stroke = f"{2000 * max(hand.max_opening for hand in context.acting_hands):.0f} mm"
            size = " x ".join(f"{1000 * length:.0f}" for length in high - low)
            reasons[
                f"it is {size} mm and has no two opposite faces less than {stroke} apart, the largest opening of a hand"
            ] = 1
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no way to take the {thing}: {summarize_reasons(reasons)}")

    def _hands_by_reach(self, context: PlanningContext, thing: str, goals: Sequence[Array]) -> list[Hand]:
        """Return the hands that may pick, that with the shortest reach to the object and its goals first."""
        places = [context.world.pose(thing)[:2, 3], *goals]
        hands = context.free_hands(self.arm)

        def distance_to_object(hand: Hand) -> float:
            base = hand.arm.T_base_in_world[:2, 3]
            return max(float(np.linalg.norm(place - base)) for place in places)

        return sorted(hands, key=distance_to_object)

    def grasp_and_lift(
        self, context: PlanningContext, hand: Hand, thing: str, found: ReachableGrasp
    ) -> Iterator[MotionSegment]:
        """Yield the motions that grasp an object and lift it.

        Raises:
            SkillFailedError: the object slipped or fell, or no path exists.
        """
        grip = found.candidate
        path = context.plan_free_path(hand, found.approach_joints, found.opening)
        yield context.make_segment(
            {hand: path}, {hand: FingerTarget(found.opening)}, wait_for_arrival=self.WAIT_FOR_REST
        )
        path = context.plan_line(hand, context.world.pose(thing) @ grip.T_pinch_in_thing)
        yield context.make_segment({hand: path}, wait_for_arrival=self.WAIT_FOR_REST)
        yield from close_fingers_on(context, hand, grip)
        if hand.side not in context.world.holding_sides(thing):
            yield from release_and_retreat(context, hand, grip.clearance)
            raise SkillFailedError(FailureCause.SLIPPED, f"the {thing} is not between the {hand.side} hand's fingers")
        hand.held_object = HeldObject(thing, invert_pose(context.T_pinch(hand)) @ context.world.pose(thing))
        T_up = hand.pinch_pose(hand.joints)
        T_up[2, 3] += self.lift
        yield context.make_segment({hand: context.plan_line(hand, T_up)}, wait_for_arrival=self.WAIT_FOR_REST)
        try:
            context.measure_held_object(hand)
        except SkillFailedError:
            yield from release_and_retreat(context, hand, grip.clearance)
            raise

    def _find_grasp(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        hand: Hand,
        thing: str,
        next_skills: Sequence[Skill],
        reasons: dict[str, int],
    ) -> ReachableGrasp | None:
        for grip in context.grasp_candidates(thing, hand.max_opening):
            found = self.find_reachable_grasp(context, hand, thing, grip)
            if isinstance(found, ReachableGrasp):
                T = invert_pose(grip.T_pinch_in_thing)
                reason = (
                    next_skills[0].infeasibility_reason(
                        context, roles, hand, thing, T, found.grasp_joints, next_skills[1:]
                    )
                    if next_skills
                    else None
                )
                if reason is None:
                    return found
                found = reason
            if found is not None:
                reasons[found] = reasons.get(found, 0) + 1
        return None

    def find_reachable_grasp(
        self, context: PlanningContext, hand: Hand, thing: str, candidate: GraspCandidate
    ) -> ReachableGrasp | str | None:
        """Return joints with which a hand reaches a grasp of an object now; else the reason why it cannot.

        The result is None if a similar grasp failed before, or if the hand cannot point there.
        """
        if candidate.opening > hand.max_opening:
            return (
                f"it is {2000 * candidate.opening:.1f} mm wide where it can be held, and the {hand.side} hand opens "
                f"{2000 * hand.max_opening:.1f} mm"
            )
        T_at = context.world.pose(thing) @ candidate.T_pinch_in_thing
        if hand.is_similar_to_failed_grasp(thing, candidate.T_pinch_in_thing) or not is_orientation_plausible(
            T_at, hand.arm.T_base_in_world
        ):
            return None
        at = hand.solve_ik(T_at, (hand.joints, hand.ready_joints))
        if at is None:
            return f"the {hand.side} arm does not reach this grasp"
        opening = min(candidate.opening + candidate.clearance, hand.max_opening)
        before, why = _approach_joints(context, hand, thing, T_at, at, opening, candidate.finger_distance)
        if before is None:
            return why
        return self._find_lift_infeasibility(context, hand, thing, candidate, T_at, at) or ReachableGrasp(
            candidate, before, at, opening
        )

    def _find_lift_infeasibility(
        self, context: PlanningContext, hand: Hand, thing: str, candidate: GraspCandidate, T_at: Array, at: Array
    ) -> str | None:
        T_up = T_at.copy()
        T_up[2, 3] += self.lift
        up = hand.solve_ik(T_up, (at,))
        if up is None:
            return f"the {hand.side} arm cannot lift it with this grasp"
        load = AttachedObject(thing, invert_pose(candidate.T_pinch_in_thing), (TABLE, *context.world.object_names))
        return context.find_contact(hand, up, candidate.opening, load)


def summarize_reasons(reasons: Mapping[str, int]) -> str:
    """Return the three most frequent reasons why grasps fail, with their numbers; "" without reasons."""
    return "; ".join(f"{why} ({number})" for why, number in sorted(reasons.items(), key=lambda item: -item[1])[:3])


def _approach_joints(
    context: PlanningContext,
    hand: Hand,
    thing: str,
    T_at: Array,
    at: Array,
    opening: float,
    finger_distance: float | None,
) -> tuple[Array | None, str]:
    """Return joints before the straight approach; else None and the reason."""
    why = context.find_contact(hand, at, opening, grasped=thing, finger_clearance=finger_distance)
    if why is not None:
        return None, why
    why = f"the {hand.side} arm does not reach the pose before this grasp"
    for distance in _APPROACH_DISTANCES:
        before = hand.solve_ik(T_at @ pose((0.0, 0.0, -distance)), (at,), WAYPOINT_TOLERANCE)
        if before is not None:
            blocked = context.find_contact(hand, before, opening)
            if blocked is None:
                return before, ""
            why = blocked
    return None, why
