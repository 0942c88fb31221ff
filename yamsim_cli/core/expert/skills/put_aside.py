from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...geometry.se3 import Array, pose, rotation_z, yaw
from .common_motions import release_and_retreat
from .hand import Hand
from .pick import Pick
from .place import PlaceSkill
from .planning_context import MotionSegment, PlanningContext, SkillFailedError
from .skill import ArmSelector, Skill, require_holding_hand

# rad, headings relative to the present one, in the order tried
_OBJECT_HEADINGS = (0.0, math.pi / 2, -math.pi / 2, math.pi)

# m and count: radii of rings around the object's position, and places on each; tried if no central place is free
_RING_RADII, _PLACES_PER_RING = (0.0, 0.06, 0.12, 0.18), 8


class PutAside(PlaceSkill):
    """Put a held object down on a free place of the table where no object started.

    The place is about as near to all acting arms; if all such places are occupied, it is near to the object.
    """

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return upright poses on free places of the table, in four headings each."""
        places = self._free_places(context, thing, context.central_places())
        if not places:
            places = self._free_places(context, thing, _places_in_rings(context.world.pose(thing)[:2, 3]))
        heading = yaw(context.world.pose(thing))
        return [
            pose((*place, context.rest_height_over(thing, place, TABLE, heading + turn)), rotation_z(heading + turn))
            for place in places
            for turn in _OBJECT_HEADINGS
        ]

    def _free_places(self, context: PlanningContext, thing: str, places: Sequence[Array]) -> list[Array]:
        return [
            place
            for place in places
            if context.is_place_free(thing, place) and not self._blocks_a_start(context, thing, place)
        ]

    @staticmethod
    def _blocks_a_start(context: PlanningContext, thing: str, place: Array) -> bool:
        radius = float(np.hypot(*context.half_footprint(thing, 0.0)))
        return any(
            float(np.linalg.norm(context.world.start_pose(other)[:2, 3] - place))
            < radius + float(np.hypot(*context.half_footprint(other, 0.0)))
            for other in context.world.object_names
        )


def _places_in_rings(place: Array) -> list[Array]:
    angles = [2 * math.pi * k / _PLACES_PER_RING for k in range(_PLACES_PER_RING)]
    return [
        place + ring * np.array((math.cos(angle), math.sin(angle)))
        for ring in _RING_RADII
        for angle in (angles if ring else angles[:1])
    ]


def put_down_failed_object(context: PlanningContext, roles: RoleAssignment, role: str) -> Iterator[MotionSegment]:
    """Put an object onto a free place, else straight down; add its grasp to the hand's `failed_grasps`.

    Raises:
        SkillFailedError: no hand holds the object any more, or it cannot be lowered.
    """
    hand = require_holding_hand(context, roles.object_of(role), "grasped in another way")
    hand.failed_grasps.append(context.measure_held_object(hand))
    try:
        yield from PutAside(thing=role).run(context, roles, ())
    except SkillFailedError:
        if hand.held_object is None:
            raise
        yield from _lower_straight(context, hand, hand.held_object.thing)


def _lower_straight(context: PlanningContext, hand: Hand, thing: str) -> Iterator[MotionSegment]:
    T, T_pinch = context.world.pose(thing), hand.pinch_pose(hand.joints)
    table = float(context.world.aabb(TABLE)[0][2])
    T_pinch[2, 3] -= T[2, 3] - context.collision_checker.rest_height(context.qpos, thing, T, table)
    yield context.make_segment({hand: context.plan_line(hand, T_pinch)})
    yield from release_and_retreat(context, hand, context.release_clearance(thing))


class Regrasp(Skill):
    """Put a held object down and pick it up again with `arm` and a grasp that leave the next skills possible."""

    TYPICAL_SECONDS: ClassVar[float] = 9.4
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = True
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    thing: str
    arm: ArmSelector = "any"

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """See `Skill.run`."""
        yield from PutAside(thing=self.thing).run(context, roles, ())
        yield from Pick(thing=self.thing, arm=self.arm).run(context, roles, next_skills)
