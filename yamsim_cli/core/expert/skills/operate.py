from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.objects.articulation import Link
from ...config.program_task import ProgramTask
from ...geometry.se3 import Array, invert_pose, pose, rotation_from_vector
from .common_motions import CLOSING_TICKS, park_free_hands, release_and_retreat, rest_segment
from .grasp_candidates import DEFAULT_FINGER_CLEARANCE
from .hand import WAYPOINT_TOLERANCE, Hand
from .planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .skill import ArmSelector, Skill

_APPROACH_LENGTH = 0.08  # m, length of the straight approach to a handle
_FINGER_FORCE = 25.0  # N, of each finger on a handle
_HAND_SPEED = 0.12  # m/s, while it moves a part

_MAX_GOAL_ERROR = 0.1  # share of the joint's range within which the joint is at its goal


class Operate(Skill):
    """Grasp a handle, move the part `joint`, such as `drawer`, along its path, and release it.

    The goal `to` is a share of the joint's range: 1 is open, 0 is closed.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str
    joint: str
    to: Annotated[FiniteFloat, Field(ge=0, le=1)]
    arm: ArmSelector = "any"

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that each object has a part `joint` with a handle."""
        return missing_part(task, self.thing, self.joint)

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if the part is at its goal; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        link = next((link for link in context.object_configs[thing].links if link.name == self.joint), None)
        if link is None or not link.handles:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"the {thing} has no part {self.joint!r} with a handle")
        if abs(context.world.joint_opening(thing, self.joint) - self.to) <= _MAX_GOAL_ERROR:
            return
        yield from self._move_part(context, thing, link)
        yield rest_segment(context)
        if abs((share := context.world.joint_opening(thing, self.joint)) - self.to) > _MAX_GOAL_ERROR:
            raise SkillFailedError(FailureCause.OFF_TARGET, f"the {self.joint} of the {thing} is {share:.0%} open")

    def _move_part(self, context: PlanningContext, thing: str, link: Link) -> Iterator[MotionSegment]:
        T_part = context.world.part_pose(thing, link.name)
        fault = f"no arm reaches a handle of the {link.name}"
        for hand in context.free_hands(self.arm):
            for handle in link.handles:
                for turn in (0.0, math.pi):
                    T_in_part = handle.T_pinch_in_part @ pose(rotation=rotation_from_vector([0.0, 0.0, turn]))
                    opening = min(handle.opening + DEFAULT_FINGER_CLEARANCE, hand.max_opening)
                    before = self._solve_approach(context, hand, thing, T_part @ T_in_part, opening)
                    pose_at = self._pinch_path(context, thing, link, T_part, T_in_part)
                    if before is None or not _can_follow_path(hand, before, pose_at):
                        continue
                    yield from park_free_hands(context, hand)
                    try:
                        path = context.plan_free_path(hand, before, opening)
                    except SkillFailedError as error:
                        fault = str(error)
                        continue
                    yield context.make_segment({hand: path}, {hand: FingerTarget(opening)})
                    yield context.make_segment({hand: context.plan_line(hand, T_part @ T_in_part)})
                    closing = FingerTarget(handle.opening, _FINGER_FORCE)
                    yield context.make_segment({hand: context.hold_still_motion(hand, CLOSING_TICKS)}, {hand: closing})
                    seconds = float(np.linalg.norm(pose_at(1.0)[:3, 3] - pose_at(0.0)[:3, 3])) / _HAND_SPEED
                    yield context.make_segment({hand: context.plan_curve(hand, pose_at, seconds)})
                    yield rest_segment(context)
                    yield from release_and_retreat(context, hand, DEFAULT_FINGER_CLEARANCE)
                    return
        raise SkillFailedError(FailureCause.UNREACHABLE, fault)

    def _solve_approach(
        self, context: PlanningContext, hand: Hand, thing: str, T_at: Array, opening: float
    ) -> Array | None:
        at = hand.solve_ik(T_at, (hand.joints, hand.ready_joints))
        if at is None or context.find_contact(hand, at, opening, grasped=thing):
            return None
        before = hand.solve_ik(T_at @ pose((0.0, 0.0, -_APPROACH_LENGTH)), (at,), WAYPOINT_TOLERANCE)
        return None if before is None or context.find_contact(hand, before, opening) else before

    def _pinch_path(
        self, context: PlanningContext, thing: str, link: Link, T_part: Array, T_in_part: Array
    ) -> Callable[[float], Array]:
        joint = link.joint
        low, high = (joint.to_si(end) for end in joint.range)
        start = low + context.world.joint_opening(thing, link.name) * (high - low)
        goal = low + self.to * (high - low)
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        T_axis = pose(joint.position)

        def pose_at(share: float) -> Array:
            change = share * (goal - start)
            if joint.is_revolute:
                return (
                    T_part
                    @ T_axis
                    @ pose(rotation=rotation_from_vector(axis * change))
                    @ invert_pose(T_axis)
                    @ T_in_part
                )
            return T_part @ pose(axis * change) @ T_in_part

        return pose_at


def _can_follow_path(hand: Hand, start: Array, pose_at: Callable[[float], Array]) -> bool:
    joints: Array | None = start
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        joints = None if joints is None else hand.solve_ik(pose_at(share), (joints,), WAYPOINT_TOLERANCE)
    return joints is not None


def missing_part(task: ProgramTask, role: str, joint: str) -> tuple[str, str] | None:
    """Return a `Skill.task_fault` if one of a role's objects has no part `joint` with a handle."""
    for item in task.possible_objects(role):
        with_handles = [link.name for link in item.links if link.handles]
        if joint not in with_handles:
            known = ", ".join(with_handles) or "(none)"
            return "joint", f"the {item.name} has no part {joint!r} with a handle; valid: {known}"
    return None
