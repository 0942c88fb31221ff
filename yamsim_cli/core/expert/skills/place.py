from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...config.program_task import ProgramTask
from ...files.documents.units import QuantityBounds, WorkspaceCoordinate
from ...geometry.se3 import Array, invert_pose, pose, rotation_z, yaw
from ..planning.collision_checker import AttachedObject
from .common_motions import plan_held_object_line, release_and_retreat, rest_segment
from .grasp_candidates import is_orientation_plausible
from .hand import WAYPOINT_TOLERANCE, Hand
from .planning_context import CachedIterable, MotionSegment, PlanningContext, SkillFailedError
from .skill import Skill, require_holding_hand

HOVER_HEIGHT = 0.07  # m, an object comes straight down from this height over its goal
_RELEASE_GAP = 0.002  # m, height of the release over the goal

_MAX_GOAL_ERROR = 0.03  # m, an object farther than this from its goal has not been placed

# sine of the hand's angle above horizontal in stable poses of the object other than upright
_MAX_UPWARD = 0.1

# rad, headings relative to the present one, the smallest first
_YAW_ANGLES = tuple(math.radians(angle) for angle in (0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180))


class _Check(IntEnum):
    """The checks of a goal, in order. If all goals fail, the message names the fault of the last check reached."""

    ROOM = 0
    REACH = 1
    REACH_OVER = 2
    CONTACT = 3
    CONTACT_OVER = 4
    WAY = 5


class PlaceSkill(Skill):
    """Base class of the skills that put down a held object; `goal_poses` gives the poses in which it may lie.

    Attributes:
        drop: height over the goal at which the object is released, so that fingers do not touch the support, m.
        unchecked_descent: last part of the way down, in which contacts are not checked, m. It is for a goal where the
            fingers come closer to the support than the planner allows, and for an object that must not fall.
    """

    TYPICAL_SECONDS: ClassVar[float] = 3.0
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = True
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = False
    LOWERING_SPEED: ClassVar[float] = 0.15  # m/s, speed at which an object comes down
    thing: str
    drop: Annotated[FiniteFloat, QuantityBounds("m", 0, 0.05)] = 0.0
    unchecked_descent: Annotated[FiniteFloat, QuantityBounds("m", 0, 0.05)] = 0.0

    def support_name(self, roles: RoleAssignment) -> str:
        """Return the name of the support: an object or `table`."""
        return TABLE

    @abstractmethod
    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> Iterable[Array]:
        """Return candidate poses of the object in `world`, the best first."""

    def _cached_goals(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> Iterable[Array]:
        """Return `goal_poses`, computed once while nothing moves: `infeasibility_reason` needs them for every grasp."""
        return context.compute_once((self, thing), lambda: CachedIterable(self.goal_poses(context, roles, thing)))

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> PlaceSkill:
        """Return the skill itself: it has no preferences."""
        return self

    def _ordered_goals(
        self, context: PlanningContext, roles: RoleAssignment, thing: str, T_thing_in_pinch: Array
    ) -> Iterable[Array]:
        return self._cached_goals(context, roles, thing)

    def approximate_targets(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> Sequence[Array]:
        """See `Skill.approximate_targets`."""
        return [T[:2, 3] for T in itertools.islice(self._cached_goals(context, roles, thing), 1)]

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
        faults = {_Check.ROOM: f"there is no room for it on or in the {self.support_name(roles)}"}
        load = AttachedObject(thing, T_thing_in_pinch, (TABLE, *context.world.object_names))
        for T_lying in self._ordered_goals(context, roles, thing, T_thing_in_pinch):
            T_goal = pose_raised_by(T_lying, self.drop + self.unchecked_descent)
            T_pinch = T_goal @ invert_pose(T_thing_in_pinch)
            can_point_there = is_orientation_plausible(T_pinch, hand.arm.T_base_in_world)
            goal_joints = hand.solve_ik(T_pinch, (joints, hand.ready_joints)) if can_point_there else None
            if goal_joints is None:
                faults[_Check.REACH] = f"the {hand.side} arm does not reach its goal with it"
                continue
            hover_joints = hand.solve_ik(
                pose_raised_by(T_goal, HOVER_HEIGHT) @ invert_pose(T_thing_in_pinch), (goal_joints,), WAYPOINT_TOLERANCE
            )
            if hover_joints is None:
                faults[_Check.REACH_OVER] = f"the {hand.side} arm does not reach over its goal with it"
            elif blocked := context.find_contact(hand, goal_joints, hand.opening, load):
                faults[_Check.CONTACT] = f"{blocked} at its goal"
            elif blocked := context.find_contact(
                hand, hover_joints, hand.opening, AttachedObject(thing, T_thing_in_pinch)
            ):
                faults[_Check.CONTACT_OVER] = f"{blocked} over its goal"
            else:
                return None
        return faults[max(faults)]

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Bring the object over the first reachable goal, lower and release it; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        hand = require_holding_hand(context, thing, "put down")
        held = context.measure_held_object(hand)
        faults = {_Check.ROOM: f"there is no room for the {thing} on or in the {self.support_name(roles)}"}
        relaxed = self.without_preferences(context, roles)
        candidates = (
            (allow_tilt, T_lying)
            for allow_tilt in (False, True)
            for T_lying in relaxed._ordered_goals(context, roles, thing, held.T_thing_in_pinch)
        )
        for allow_tilt, T_lying in candidates:
            T_goal = pose_raised_by(T_lying, self.drop + self.unchecked_descent)
            T_pinch = T_goal @ invert_pose(held.T_thing_in_pinch)
            with context.planning_limits(0.0, allow_tilt):
                joints = self._hover_joints(hand, T_pinch)
                if joints is None or hand.solve_ik(T_pinch, (joints,), WAYPOINT_TOLERANCE) is None:
                    faults[_Check.REACH_OVER] = f"the {hand.side} arm does not reach over its goal with the {thing}"
                    continue
            try:
                path = context.plan_free_path(hand, joints, attached=AttachedObject(thing, held.T_thing_in_pinch))
            except SkillFailedError as error:
                faults[_Check.WAY] = str(error)
                continue
            yield context.make_segment({hand: path})
            yield from self._lower_and_release(context, hand, thing, pose_raised_by(T_lying, self.drop))
            self._require_placed(context, thing, self.support_name(roles), T_lying)
            return
        raise SkillFailedError(FailureCause.UNREACHABLE, faults[max(faults)])

    def _hover_joints(self, hand: Hand, T_pinch: Array) -> Array | None:
        return hand.solve_ik(
            pose_raised_by(T_pinch, HOVER_HEIGHT), (hand.joints, hand.ready_joints), WAYPOINT_TOLERANCE
        )

    def _lower_and_release(
        self, context: PlanningContext, hand: Hand, thing: str, T_goal: Array
    ) -> Iterator[MotionSegment]:
        yield context.make_segment(
            {hand: plan_held_object_line(context, hand, pose_raised_by(T_goal, _RELEASE_GAP), self.LOWERING_SPEED)}
        )
        yield rest_segment(context)
        yield from self._release(context, hand, thing)

    def _release(self, context: PlanningContext, hand: Hand, thing: str) -> Iterator[MotionSegment]:
        yield from release_and_retreat(context, hand, context.release_clearance(thing))
        yield rest_segment(context)

    def _require_placed(self, context: PlanningContext, thing: str, onto: str, T_goal: Array) -> None:
        T = context.world.pose(thing)
        offset = float(np.linalg.norm(T[:2, 3] - T_goal[:2, 3]))
        if offset > _MAX_GOAL_ERROR or T[2, 3] < T_goal[2, 3] - _MAX_GOAL_ERROR:
            raise SkillFailedError(
                FailureCause.OFF_TARGET, f"the {thing} lies {offset * 1000:.0f} mm beside its place on the {onto}"
            )


class Place(PlaceSkill):
    """Put an object down, upright and with the heading that suits the arm.

    If no grasp allows that, an object whose config has `rests` may be put down in another stable pose.

    Attributes:
        on: a role, or `table`; the object is put over the middle of the role's object, on it or in it.
        at: x and y on the support, in its frame, m; for the table, in `world`.
        start_of: a role, instead of `at`: the point where that role's object started.
        step: offset from `at`, m, which is applied `number` times.
        heading_deg: in the support's frame; None for any. With a heading, the object stands upright.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "on", "start_of")
    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]] = ("on",)
    ROLES_OF_ANY_MATERIAL: ClassVar[tuple[str, ...]] = ("on",)
    on: str
    at: tuple[WorkspaceCoordinate, WorkspaceCoordinate] | None = None
    start_of: str | None = None
    step: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    number: Annotated[int, Field(ge=0)] = 0
    heading_deg: Annotated[FiniteFloat, Field(ge=-360, le=360)] | None = None
    upright: bool = False

    @model_validator(mode="after")
    def _has_explicit_place(self) -> Place:
        if self.on == TABLE and self.at is None and self.start_of is None:
            raise ValueError("`on: table` needs a place: give `at` or `start_of`")
        return self

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that each object that may be `on` can support another one."""
        for item in () if self.on == TABLE else task.possible_objects(self.on):
            if item.cloth is None and not item.can_support:
                return "on", f"target {item.name!r} has neither a floor nor a flat top to put something on"
        return None

    def point_on_table(self) -> tuple[str, Array] | None:
        """See `Skill.point_on_table`."""
        if self.on != TABLE or self.at is None or self.start_of is not None:
            return None
        return "at", np.array(self.at) + self.number * np.array(self.step)

    def support_name(self, roles: RoleAssignment) -> str:
        """See `PlaceSkill.support_name`."""
        return TABLE if self.on == TABLE else roles.object_of(self.on)

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> Iterator[Array]:
        """Yield upright poses over the goal's point: with `heading_deg`, else first with the present heading."""
        onto = self.support_name(roles)
        place, T_onto = self._goal_point_and_support(context, roles)
        if self.heading_deg is not None:
            headings = [yaw(T_onto) + math.radians(self.heading_deg)]
        else:
            headings = [yaw(context.world.pose(thing)) + turn for turn in _YAW_ANGLES]
        for heading in headings:
            yield pose((*place, context.rest_height_over(thing, place, onto, heading)), rotation_z(heading))

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Place:
        """Return a skill that may choose other stable poses than upright, if the object's config allows that."""
        fixed = self.upright or self.heading_deg is not None
        if fixed or not context.object_configs[roles.object_of(self.thing)].rests_in_any_pose:
            return self
        return _PlaceInAnyStablePose.model_construct(**dict(self))

    def _goal_point_and_support(self, context: PlanningContext, roles: RoleAssignment) -> tuple[Array, Array]:
        onto = self.support_name(roles)
        T_onto = pose() if onto == TABLE else context.world.pose(onto)
        x, y = np.array(self.at or (0.0, 0.0)) + self.number * np.array(self.step)
        if self.start_of is not None:
            return context.world.start_pose(roles.object_of(self.start_of))[:2, 3], T_onto
        return (T_onto @ (x, y, 0.0, 1.0))[:2], T_onto


class _PlaceInAnyStablePose(Place):
    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Place:
        return self

    def _ordered_goals(
        self, context: PlanningContext, roles: RoleAssignment, thing: str, T_thing_in_pinch: Array
    ) -> Iterator[Array]:
        """Yield upright goals first, then the others by how steeply the hand would point down."""
        yield from self._cached_goals(context, roles, thing)
        lying = context.compute_once((self, "others", thing), lambda: self._lying_goals(context, roles, thing))
        T_pinch_in_thing = invert_pose(T_thing_in_pinch)

        def move_forward(T: Array) -> Array:
            direction: Array = (T @ T_pinch_in_thing)[:3, 2]
            return direction

        reachable = [T for T in lying if move_forward(T)[2] < _MAX_UPWARD]
        yield from sorted(reachable, key=lambda T: float(move_forward(T)[2]))

    def _lying_goals(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return goals in stable poses other than upright, with the centre of mass over the point."""
        place, _ = self._goal_point_and_support(context, roles)
        centre = np.array(context.object_configs[thing].inertia.centre)
        heading = yaw(context.world.pose(thing))
        found = []
        for R in context.stable_rotations(thing)[1:]:
            for turn in _YAW_ANGLES:
                turned = rotation_z(heading + turn) @ R
                T = pose((*(place - (turned @ centre)[:2]), 0.0), turned)
                T[2, 3] = context.rest_height_of(thing, T, self.support_name(roles))
                found.append(T)
        return found


def pose_raised_by(T: Array, height: float) -> Array:
    """Return a pose moved up by a height, m."""
    higher = T.copy()
    higher[2, 3] += height
    return higher
