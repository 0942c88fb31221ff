"""`PressLevel`: press a tilted object level, such as a bowl that lies askew in a larger one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.config.goals.role_assignment import RoleAssignment
from ..core.expert.skills.common_motions import park_free_hands, rest_segment
from ..core.expert.skills.hand import WAYPOINT_TOLERANCE, Hand
from ..core.expert.skills.place import pose_raised_by
from ..core.expert.skills.planning_context import FingerTarget, MotionSegment, PlanningContext
from ..core.expert.skills.skill import Skill
from ..core.geometry.se3 import Array, pose, rotation_from_vector, rotation_z

# Of the tilt; an object with a larger cosine is level. Bowls that lay askew were tilted by 12 to 17 degrees.
_LEVEL_COSINE = math.cos(math.radians(4))
_MAX_PRESSES = 2  # a press takes 5 to 9 of the 80 actions that KitchenBench allows
_ABOVE = 0.05  # m over the rim, where the descent starts; no other value was tried
# m below the rim's highest point, where the descent ends: a bowl 141 mm wide was 31 mm higher on one side
_PRESSED = 0.025
# rad, angles of the hand from vertical, and its headings. The pose with the smallest change of joints comes first.
_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))
_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))


@dataclass(frozen=True)
class _Press:
    """Joints (dof,) of a hand above the rim, and the pose (4, 4) of its pinch frame at the end of the descent."""

    hand: Hand
    above: Array
    T_pressed: Array

    @property
    def largest_joint_change(self) -> float:
        """Largest change of a joint on the way to the rim, rad."""
        return float(np.abs(self.above - self.hand.joints).max())


class PressLevel(Skill):
    """Press closed fingers onto the highest part of a tilted object's rim; do nothing if it is level."""

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    thing: str

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Yield the motions; see `Skill.run`. An object out of reach, or upside down, stays as it is."""
        thing = roles.object_of(self.thing)
        for _ in range(_MAX_PRESSES):
            if not 0.0 < context.world.pose(thing)[2, 2] <= _LEVEL_COSINE:
                return
            presses = list(_presses(context, _highest_rim_point(context, thing)))
            if not presses:
                return
            press = min(presses, key=lambda each: each.largest_joint_change)
            hand, T_up = press.hand, pose_raised_by(press.T_pressed, _PRESSED + _ABOVE)
            yield from park_free_hands(context, hand)
            closed = {hand: FingerTarget(0.0)}
            yield context.make_segment(
                {hand: context.plan_free_path(hand, press.above)}, closed, wait_for_arrival=False
            )
            yield context.make_segment({hand: context.plan_line(hand, press.T_pressed)})
            yield context.make_segment({hand: context.plan_line(hand, T_up)}, wait_for_arrival=False)
            yield rest_segment(context)


def _highest_rim_point(context: PlanningContext, thing: str) -> Array:
    """Return the point (3,) of a round object's rim that its tilt raises most, in `world`, m."""
    T, high = context.world.pose(thing), context.world.local_box(thing)[1]
    uphill = T[2, :2] / np.linalg.norm(T[2, :2])
    point: Array = (T @ (*(high[:2].min() * uphill), high[2], 1.0))[:3]
    return point


def _presses(context: PlanningContext, point: Array) -> Iterator[_Press]:
    """Yield the ways in which free hands reach down to a point (3,) in `world`, m."""
    down = rotation_from_vector([math.pi, 0.0, 0.0])
    for hand, tilt, heading in itertools.product(context.free_hands("any"), _TILTS, _HEADINGS):
        T = pose(point, rotation_z(heading) @ down @ rotation_from_vector([tilt, 0.0, 0.0]))
        above = hand.solve_ik(pose_raised_by(T, _ABOVE), (hand.joints, hand.ready_joints), WAYPOINT_TOLERANCE)
        if above is None or context.find_contact(hand, above, 0.0):
            continue
        T_pressed = pose_raised_by(T, -_PRESSED)
        if hand.solve_ik(T_pressed, (above,), WAYPOINT_TOLERANCE) is not None:
            yield _Press(hand, above, T_pressed)
