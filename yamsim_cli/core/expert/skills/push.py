from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...files.documents.config_base import Positive
from ...files.documents.units import WorkspaceCoordinate
from ...geometry.se3 import Array, pose, rotation_z
from .common_motions import CLOSING_TICKS, park_free_hands, rest_segment
from .hand import WAYPOINT_TOLERANCE, Hand
from .planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .skill import ArmSelector, Skill

_FINGER_GAP_BEHIND_OBJECT = 0.03  # m, between the object and the fingers when they come down behind it
_APPROACH_HEIGHT = 0.10  # m above the pushing height, from which the fingers come down
_PUSH_HEIGHT = 0.02  # m, of the fingertips over the table

_PUSH_SPEED = 0.10  # m/s

_MAX_PUSHES = 3

# rad about the vertical axis, in the order tried; at 0, the fingers stand side by side
_HAND_HEADINGS = (0.0, math.pi, math.pi / 2, -math.pi / 2)
# rad from straight down, in the order tried
_HAND_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 40))


class Push(Skill):
    """Push a low object in a straight line to a point, with closed fingers; the hand needs room behind the object.

    Attributes:
        to: x and y of the point in `world`, m.
        radius: distance from the point at which the push succeeds, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str
    to: tuple[WorkspaceCoordinate, WorkspaceCoordinate]
    radius: Positive = 0.02
    arm: ArmSelector = "any"

    def point_on_table(self) -> tuple[str, Array]:
        """Return the goal; see `Skill.point_on_table`."""
        return "to", np.array(self.to)

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Push until the object is within `radius` of the point; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        for _ in range(_MAX_PUSHES):
            if self._distance_to_goal(context, thing) <= self.radius:
                return
            yield from self._push_once(context, thing)
            yield rest_segment(context)
        if (distance := self._distance_to_goal(context, thing)) > self.radius:
            raise SkillFailedError(
                FailureCause.OFF_TARGET, f"the {thing} was pushed to {distance * 1000:.0f} mm from its place"
            )

    def _distance_to_goal(self, context: PlanningContext, thing: str) -> float:
        return float(np.linalg.norm(context.world.pose(thing)[:2, 3] - self.to))

    def _push_once(self, context: PlanningContext, thing: str) -> Iterator[MotionSegment]:
        start = context.world.pose(thing)[:2, 3]
        displacement = np.array(self.to) - start
        heading = math.atan2(displacement[1], displacement[0])
        half = float(context.half_footprint(thing, -heading)[0])
        direction = displacement / np.linalg.norm(displacement)
        first, last = start - direction * (half + _FINGER_GAP_BEHIND_OBJECT), np.array(self.to) - direction * half
        hands = context.free_hands(self.arm)
        for hand in sorted(hands, key=lambda hand: float(np.linalg.norm(hand.arm.T_base_in_world[:2, 3] - first))):
            for lean, turn in itertools.product(_HAND_TILTS, _HAND_HEADINGS):
                found = self._solve_start_and_end(context, hand, first, last, heading + turn, lean)
                if found is None:
                    continue
                yield from park_free_hands(context, hand)
                joints, T_first, T_last = found
                closed = FingerTarget(0.0)
                yield context.make_segment({hand: context.plan_free_path(hand, joints)}, {hand: closed})
                yield context.make_segment({hand: context.hold_still_motion(hand, CLOSING_TICKS)}, {hand: closed})
                yield context.make_segment({hand: context.plan_line(hand, T_first)})
                yield context.make_segment({hand: context.plan_line(hand, T_last, _PUSH_SPEED)})
                T_back = T_last.copy()
                T_back[:2, 3] -= direction * _FINGER_GAP_BEHIND_OBJECT
                yield context.make_segment({hand: context.plan_line(hand, T_back)})
                T_back[2, 3] += _APPROACH_HEIGHT
                yield context.make_segment({hand: context.plan_line(hand, T_back)})
                return
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no arm reaches behind the {thing} and its target place")

    def _solve_start_and_end(
        self, context: PlanningContext, hand: Hand, first: Array, last: Array, heading: float, lean: float
    ) -> tuple[Array, Array, Array] | None:
        height = float(context.world.aabb(TABLE)[1][2]) + _PUSH_HEIGHT
        # The fingers point down; the closing axis lies across the push.
        down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        c, s = math.cos(lean), math.sin(lean)
        R = rotation_z(heading) @ down @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        T_first, T_last = pose((*first, height), R), pose((*last, height), R)
        T_over = T_first.copy()
        T_over[2, 3] += _APPROACH_HEIGHT
        over = hand.solve_ik(T_over, (hand.joints, hand.ready_joints), WAYPOINT_TOLERANCE)
        if over is None or context.find_contact(hand, over, 0.0):
            return None
        begun = hand.solve_ik(T_first, (over,), WAYPOINT_TOLERANCE)
        if (
            begun is None
            or context.find_contact(hand, begun, 0.0)
            or hand.solve_ik(T_last, (begun,), WAYPOINT_TOLERANCE) is None
        ):
            return None
        return over, T_first, T_last
