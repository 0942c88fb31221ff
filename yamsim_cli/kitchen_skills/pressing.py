"""`press_point`: press closed fingers down onto an object."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.expert.skills.common_motions import park_free_hands, rest_segment
from ..core.expert.skills.hand import WAYPOINT_TOLERANCE, Hand
from ..core.expert.skills.place import pose_raised_by
from ..core.expert.skills.planning_context import FingerTarget, MotionSegment, PlanningContext
from ..core.geometry.se3 import Array, pose, rotation_from_vector, rotation_z

_ABOVE = 0.05  # m over the pressed point, where the descent starts; no other value was tried
# rad, angles of the hand from vertical, and its headings. The pose with the smallest change of joints comes first.
_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))
_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))


@dataclass(frozen=True)
class _Press:
    """Joints (dof,) of a hand above a point, and the pose (4, 4) of its pinch frame at the end of the descent."""

    hand: Hand
    above: Array
    T_pressed: Array

    @property
    def largest_joint_change(self) -> float:
        """Largest change of a joint on the way to the point, rad."""
        return float(np.abs(self.above - self.hand.joints).max())


def press_point(context: PlanningContext, point: Array, depth: float) -> Iterator[MotionSegment]:
    """Move the pinch frame of closed fingers from above a point (3,) in `world`, m, to `depth` (m) below it.

    The function chooses the free hand whose joints move least, and parks the other free hands first. If no hand reaches
    the point, nothing moves.
    """
    presses = list(_presses(context, point, depth))
    if not presses:
        return
    press = min(presses, key=lambda each: each.largest_joint_change)
    hand, T_up = press.hand, pose_raised_by(press.T_pressed, depth + _ABOVE)
    yield from park_free_hands(context, hand)
    closed = {hand: FingerTarget(0.0)}
    yield context.make_segment({hand: context.plan_free_path(hand, press.above)}, closed, wait_for_arrival=False)
    yield context.make_segment({hand: context.plan_line(hand, press.T_pressed)})
    yield context.make_segment({hand: context.plan_line(hand, T_up)}, wait_for_arrival=False)
    yield rest_segment(context)


def _presses(context: PlanningContext, point: Array, depth: float) -> Iterator[_Press]:
    """Yield the ways in which free hands reach down to a point (3,) in `world`, m."""
    down = rotation_from_vector([math.pi, 0.0, 0.0])
    for hand, tilt, heading in itertools.product(context.free_hands("any"), _TILTS, _HEADINGS):
        T = pose(point, rotation_z(heading) @ down @ rotation_from_vector([tilt, 0.0, 0.0]))
        above = hand.solve_ik(pose_raised_by(T, _ABOVE), (hand.joints, hand.ready_joints), WAYPOINT_TOLERANCE)
        if above is None or context.find_contact(hand, above, 0.0):
            continue
        T_pressed = pose_raised_by(T, -depth)
        if hand.solve_ik(T_pressed, (above,), WAYPOINT_TOLERANCE) is not None:
            yield _Press(hand, above, T_pressed)
