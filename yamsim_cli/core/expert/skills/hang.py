from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...attempt_data import FailureCause
from ...config.goals.predicates import Hung
from ...config.goals.role_assignment import RoleAssignment
from ...config.program_task import ProgramTask
from ...geometry.se3 import Array, invert_pose, pose, rotation_z
from ..planning.collision_checker import AttachedObject
from ..planning.trajectory import is_collision_free, plan_cartesian_line
from .common_motions import park_free_hands, plan_held_object_line, release_and_retreat, rest_segment
from .hand import WAYPOINT_TOLERANCE, Hand
from .planning_context import MotionSegment, PlanningContext, SkillFailedError
from .skill import Skill, require_holding_hand

_PEG_INSERTION_DEPTHS = (0.045, 0.055, 0.035)  # m, of the eye behind the peg's tip, in the order tried
_APPROACH_LENGTH = 0.04  # m, from the eye to the peg's tip when the straight approach starts

# rad, tilts of the object about the peg, in the order tried; the object may turn when released
_OBJECT_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))

_HANG_SPEED = 0.10  # m/s, onto the peg and down
_RELEASE_HEIGHT_OVER_PEG = 0.001  # m, of the eye over the peg
_SWING_TICKS = 40  # control ticks in which the object swings to rest


class Hang(Skill):
    """Move the eye of a held object over a peg, and release the object.

    The object's handle `eye` points through an opening. The handle `peg` of `onto` points from the peg's tip to its
    root.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "onto")
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = True
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = False
    thing: str
    onto: str

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that each object has the handle of its role: an eye, or a peg."""
        return Hung(thing=self.thing, onto=self.onto).missing_handle(task.possible_objects)

    def approximate_targets(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> Sequence[Array]:
        """Return the point (2,) of the peg's tip in `world`, m."""
        return [context.world.handle_pose(roles.object_of(self.onto), "peg")[:2, 3]]

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
        fault = f"the {hand.side} arm does not reach the peg with it"
        load = AttachedObject(thing, T_thing_in_pinch)
        for before, T_on in self._hang_candidates(
            context, roles, hand, thing, T_thing_in_pinch, (joints, hand.ready_joints)
        ):
            at_peg = hand.solve_ik(T_on @ invert_pose(T_thing_in_pinch), (before,), WAYPOINT_TOLERANCE)
            if at_peg is None:
                continue
            blocked = context.find_contact(hand, at_peg, hand.opening, load) or context.find_contact(
                hand, before, hand.opening, load
            )
            if blocked is None:
                return None
            fault = f"{blocked} at the peg"
        return fault

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill.run`."""
        thing = roles.object_of(self.thing)
        hand = require_holding_hand(context, thing, "hung up")
        held = context.measure_held_object(hand)
        yield from park_free_hands(context, hand)
        load = AttachedObject(thing, held.T_thing_in_pinch)
        fault = f"the {hand.side} arm does not reach the peg with the {thing}"
        candidates = self._hang_candidates(
            context, roles, hand, thing, held.T_thing_in_pinch, (hand.joints, hand.ready_joints)
        )
        for before, T_on in candidates:
            onto = plan_cartesian_line(
                hand.ik, before, T_on @ invert_pose(held.T_thing_in_pinch), context.tick, _HANG_SPEED
            )
            if onto is None or not is_collision_free(
                onto, lambda joints: context.find_contact(hand, joints, hand.opening, load)
            ):
                continue
            try:
                path = context.plan_free_path(hand, before, attached=load)
            except SkillFailedError as error:
                fault = str(error)
                continue
            yield context.make_segment({hand: path})
            yield context.make_segment({hand: plan_held_object_line(context, hand, T_on, _HANG_SPEED)})
            T_down = context.world.pose(thing)
            T_down[2, 3] = (
                context.collision_checker.rest_height(context.qpos, thing, T_down, T_down[2, 3] - _APPROACH_LENGTH)
                + _RELEASE_HEIGHT_OVER_PEG
            )
            yield context.make_segment({hand: plan_held_object_line(context, hand, T_down, _HANG_SPEED)})
            yield from release_and_retreat(context, hand, context.release_clearance(thing))
            yield context.wait_segment(_SWING_TICKS)
            yield rest_segment(context)
            self._require_hung(context, roles)
            return
        raise SkillFailedError(FailureCause.UNREACHABLE, fault)

    def _hang_candidates(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        seeds: Sequence[Array],
    ) -> Iterator[tuple[Array, Array]]:
        T_peg = context.world.handle_pose(roles.object_of(self.onto), "peg")
        T_eye_in_thing = invert_pose(context.world.pose(thing)) @ context.world.handle_pose(thing, "eye")
        for T_eye in _eye_poses_on_peg(T_peg):
            T_on = T_eye @ invert_pose(T_eye_in_thing)
            T_before = T_on.copy()
            T_before[:3, 3] -= T_peg[:3, 2] * (_APPROACH_LENGTH + float((T_eye - T_peg)[:3, 3] @ T_peg[:3, 2]))
            before = hand.solve_ik(T_before @ invert_pose(T_thing_in_pinch), seeds, WAYPOINT_TOLERANCE)
            if before is not None:
                yield before, T_on

    def _require_hung(self, context: PlanningContext, roles: RoleAssignment) -> None:
        for measure in Hung(thing=self.thing, onto=self.onto).measures(context.world, roles):
            if not measure.holds:
                raise SkillFailedError(FailureCause.OFF_TARGET, f"{measure.what}: {measure.detail}")


def _eye_poses_on_peg(T_peg: Array) -> Iterator[Array]:
    """Yield poses of an eye on a peg, in `world`, y up; least tilt first."""
    along = T_peg[:3, 2]
    horizontal = np.array((along[0], along[1], 0.0)) / math.hypot(along[0], along[1])
    for lean in _OBJECT_TILTS:
        for depth in _PEG_INSERTION_DEPTHS:
            for z in (horizontal, -horizontal):
                R = np.column_stack([np.cross((0.0, 0.0, 1.0), z), (0.0, 0.0, 1.0), z]) @ rotation_z(lean)
                yield pose(T_peg[:3, 3] + depth * along, R)
