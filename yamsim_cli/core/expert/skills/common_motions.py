"""Motions that several skills share. A hand is parked if its arm is in the ready posture."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from ...geometry.se3 import Array, invert_pose, pose
from ..planning.trajectory import is_collision_free
from .grasp_candidates import GraspCandidate
from .hand import WAYPOINT_TOLERANCE, Hand
from .planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError

CLOSING_TICKS = 10
_OPEN_TICKS = 8
_SETTLING_TICKS = 4  # control ticks in which arms and a released object come to rest

# m from a released object; the shorter retreat is used if the other ends near a joint limit
_RETREAT_DISTANCE, _SHORT_RETREAT_DISTANCE = 0.07, 0.04


def close_fingers_on(context: PlanningContext, hand: Hand, candidate: GraspCandidate) -> Iterator[MotionSegment]:
    """Close the fingers on the object between them, and wait until everything rests.

    Fingers close with the grasp's force. A hand with a weld closes to the object's width, and switches its weld on.
    """
    closing = FingerTarget(candidate.opening, 0.0 if hand.grasps_by_weld else candidate.force)
    yield context.make_segment({hand: context.hold_still_motion(hand, CLOSING_TICKS)}, {hand: closing})
    hand.weld_commanded = hand.grasps_by_weld
    yield rest_segment(context)


def release_and_retreat(
    context: PlanningContext, hand: Hand, clearance: float, finger_distance: float | None = None
) -> Iterator[MotionSegment]:
    """Open each finger by a clearance (m), and move the hand back along its axis or up.

    `finger_distance` is the least distance of the fingers from other objects, m; None: as for the arm.
    """
    opening = min(hand.opening + clearance, hand.max_opening)
    hand.weld_commanded = False
    yield context.make_segment(
        {hand: context.hold_still_motion(hand, _OPEN_TICKS)}, {hand: FingerTarget(opening)}, wait_for_arrival=False
    )
    thing, hand.held_object = None if hand.held_object is None else hand.held_object.thing, None
    # Open fingers are still near the object. If no path is free of contacts, the first path is used.
    retreat: Array | None = None
    for path in _retreat_paths(context, hand):
        if is_collision_free(
            path, lambda joints: context.find_contact(hand, joints, opening, None, thing, finger_distance)
        ):
            retreat = path
            break
        retreat = path if retreat is None else retreat
    if retreat is not None:
        yield context.make_segment({hand: retreat}, wait_for_arrival=False)


def _retreat_paths(context: PlanningContext, hand: Hand) -> Iterator[Array]:
    """Yield straight paths away from a released object; paths that end near joint limits come last."""
    T = hand.pinch_pose(hand.joints)
    paths = []
    for distance in (_RETREAT_DISTANCE, _SHORT_RETREAT_DISTANCE):
        back, up = T @ pose((0.0, 0.0, -distance)), T.copy()
        up[2, 3] += distance
        for T_clear in (back, up):
            with suppress(SkillFailedError):
                path = context.plan_line(hand, T_clear)
                if hand.ik.solution_at(path[-1]).joint_limit_margin >= WAYPOINT_TOLERANCE.joint_limit_margin:
                    yield path
                else:
                    paths.append(path)
    yield from paths


def plan_held_object_line(context: PlanningContext, hand: Hand, T_thing: Array, speed: float) -> Array:
    """Return a motion (n + 1, dof) that moves a held object straight to a pose in `world`, at a speed in m/s."""
    held = context.measure_held_object(hand)
    # The arm sags under its load: this transform leads from the measured pose to the commanded pose.
    T_commanded_in_pinch = invert_pose(context.T_pinch(hand)) @ hand.pinch_pose(hand.joints)
    return context.plan_line(hand, T_thing @ invert_pose(held.T_thing_in_pinch) @ T_commanded_in_pinch, speed)


def park_hand(context: PlanningContext, hand: Hand) -> Iterator[MotionSegment]:
    """Move a hand to its ready posture, unless it is there already."""
    if not _is_parked(hand):
        yield context.make_segment({hand: context.plan_free_path(hand, hand.ready_joints)}, wait_for_arrival=False)


def unparked_hands(context: PlanningContext) -> list[Hand]:
    """Return the acting hands that hold nothing and are not parked."""
    return [hand for hand in context.free_hands("any") if not _is_parked(hand)]


def _is_parked(hand: Hand) -> bool:
    return bool(abs(hand.joints - hand.ready_joints).max() <= 1e-6)


def park_free_hands(context: PlanningContext, except_hand: Hand | None = None) -> Iterator[MotionSegment]:
    """Park all other hands that hold nothing."""
    for hand in context.hands:
        if hand is not except_hand and hand.held_object is None:
            yield from park_hand(context, hand)


def rest_segment(context: PlanningContext) -> MotionSegment:
    """Return a short segment without motion, in which arms and released objects come to rest."""
    return context.wait_segment(_SETTLING_TICKS)


def open_and_park_hands(context: PlanningContext) -> Iterator[MotionSegment]:
    """Open and park all hands that hold nothing; a blocked hand waits until others are parked."""
    waiting = context.free_hands("any")
    while waiting:
        before, errors = len(waiting), list[SkillFailedError]()
        for hand in tuple(waiting):
            try:
                if hand.opening < hand.max_opening / 4:
                    yield from release_and_retreat(context, hand, hand.max_opening / 2)
                yield from park_hand(context, hand)
                waiting.remove(hand)
            except SkillFailedError as fault:
                errors.append(fault)
        if len(waiting) == before:
            raise errors[0]
