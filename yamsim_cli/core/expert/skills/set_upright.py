from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...geometry.se3 import Array, pose, rotation_z, tilt_angle
from .pick import Pick
from .place import PlaceSkill
from .planning_context import MotionSegment, PlanningContext, SkillFailedError
from .skill import Skill, find_holding_hand

_RING_RADII = (0.0, 0.05, 0.10, 0.15, 0.20)  # m, of rings of places around the object
_PLACES_PER_RING = 8

_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))  # rad, tried at each place

_MAX_TILT = math.radians(10)  # rad, an object that tilts more has fallen over again


class SetUpright(PlaceSkill):
    """Put a lying or inverted object down upright, near its present place.

    An object that is in no hand is picked up first. If no grasp allows an upright pose, `TurnTowardsArms` first turns
    the object.
    """

    TYPICAL_SECONDS: ClassVar[float] = 7.0
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = None

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill.run`."""
        thing, pick = roles.object_of(self.thing), Pick(thing=self.thing)
        if find_holding_hand(context, thing) is None:
            try:
                yield from pick.run(context, roles, (self,))
            except SkillFailedError as error:
                if error.cause is not FailureCause.UNREACHABLE or find_holding_hand(context, thing) is not None:
                    raise
                turn_skill = TurnTowardsArms(thing=self.thing)
                yield from pick.run(context, roles, (turn_skill,))
                yield from turn_skill.run(context, roles, (pick,))
                yield from pick.run(context, roles, (self,))
        yield from super().run(context, roles, next_skills)

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return upright poses on free places in rings around the object, in eight headings each."""
        low, high = context.world.aabb(thing)
        middle = (low[:2] + high[:2]) / 2
        found = []
        for ring in _RING_RADII:
            for k in range(_PLACES_PER_RING if ring else 1):
                angle = 2 * math.pi * k / _PLACES_PER_RING
                place = middle + ring * np.array((math.cos(angle), math.sin(angle)))
                if context.is_place_free(thing, place):
                    height = context.rest_height_over(thing, place, TABLE, 0.0)
                    found += [pose((*place, height), rotation_z(heading)) for heading in _HEADINGS]
        return found

    def _require_placed(self, context: PlanningContext, thing: str, onto: str, T_goal: Array) -> None:
        super()._require_placed(context, thing, onto, T_goal)
        if (leans := tilt_angle(context.world.pose(thing)[:3, :3])) > _MAX_TILT:
            raise SkillFailedError(FailureCause.OFF_TARGET, f"the {thing} leans by {math.degrees(leans):.0f} degrees")


# rad, from the direction towards the arms to the upper end, in the order tried
_HEADING_DEVIATIONS = tuple(math.radians(angle) for angle in (0, 30, -30, 60, -60))
_SHIFTS_TOWARDS_ARMS = (0.0, 0.06, 0.12)  # m, towards the arms, which reach nearer places best

_SEARCH_START_HEIGHT = 0.2  # m over the table, where the search for the resting height starts


class TurnTowardsArms(PlaceSkill):
    """Put a held, lying object down in the same stable pose, with its z axis towards the arms."""

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return poses in which the object's z axis points towards the arms."""
        T, table = context.world.pose(thing), float(context.world.aabb(TABLE)[1][2])
        low, high = context.world.aabb(thing)
        middle = (low + high) / 2
        towards = context.base_midpoint - middle[:2]
        towards /= np.linalg.norm(towards)
        found = []
        for shift in _SHIFTS_TOWARDS_ARMS:
            for deviation in _HEADING_DEVIATIONS:
                turn = math.atan2(towards[1], towards[0]) + deviation - math.atan2(T[1, 2], T[0, 2])
                R = rotation_z(turn)
                origin = middle + R @ (T[:3, 3] - middle)
                origin[:2] += shift * towards
                T_goal = pose((*origin[:2], table + _SEARCH_START_HEIGHT), R @ T[:3, :3])
                T_goal[2, 3] = context.collision_checker.rest_height(
                    context.qpos, thing, T_goal, table - _SEARCH_START_HEIGHT
                )
                found.append(T_goal)
        return found
