from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.geometry.se3 import Array, interpolate_rotation, pose
from yamsim_cli.core.sim.cloth import points_between_pads, simulate_pull

from ..common_motions import CLOSING_TICKS, rest_segment, unparked_hands
from ..hand import Hand
from ..planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from .point_grasps import APPROACH_DISTANCE, APPROACH_OPENING, TIP_CLEARANCE, PointGrasp, are_hands_clear

CARRY_SPEED = 0.12  # m/s, of a hand that carries cloth
ARCH_HEIGHT_RATIO = 0.45  # height of a fold's path, as a share of its length

_CLOTH_GRIP_FORCE = 20.0  # N, of closed fingers on cloth

# m, a hand grasps lower by a step on each retry after a miss
_DEPTH_STEP = 0.002
RETRY_DEPTHS = (_DEPTH_STEP, 2 * _DEPTH_STEP, 3 * _DEPTH_STEP, 4 * _DEPTH_STEP)
_OPEN_TICKS = 4  # control ticks in which fingers open before a retry

_MAX_OPEN_OPENING = 2 * APPROACH_OPENING  # m, before a grasp; fingers that are more open are stuck
_MAX_CLOSED_OPENING = 0.006  # m, more than cloth is thick

_RETREAT_DISTANCE = 0.04  # m, of a hand out from under the cloth that it placed
_DROP_HEIGHT = 0.002  # m over the target at which a folded point is released
_PULL_HEIGHT = 0.006  # m over the table: tips that rub on the table hold arms back by 2 to 4 cm


def predict_cloth_points(
    context: PlanningContext,
    thing: str,
    grasps: Sequence[PointGrasp],
    arch: float = ARCH_HEIGHT_RATIO,
    speed: float = CARRY_SPEED,
) -> Array:
    """Return a cloth's points (along y, along x, 3) in `world` after `carry_points` with the same arguments, m.

    The simulation has no hands: the grasped points move on prescribed paths.
    """
    cloth, points = context.world.cloth_addresses(thing), context.world.cloth_points(thing)
    patches = []
    for grasp in grasps:
        row, column = grasp.placement.point
        between = points_between_pads(cloth, points.reshape(-1, 3), grasp.T_grasp)
        patches.append(np.union1d(between, [row * points.shape[1] + column]))
    paths = [grasp.placement.target(points) - points[grasp.placement.point] for grasp in grasps]
    seconds = max(float(np.linalg.norm(path[:2])) for path in paths) / speed
    return simulate_pull(context.world.data, context.model, cloth, patches, paths, arch, seconds)


def carry_points(
    context: PlanningContext,
    thing: str,
    grasps: Sequence[PointGrasp],
    arch: float = ARCH_HEIGHT_RATIO,
    speed: float = CARRY_SPEED,
) -> Iterator[MotionSegment]:
    """Grasp points of a cloth, carry them to their targets at a speed (m/s), and release them.

    `arch` is the height of the path, as a share of its length.
    """
    opened = {grasp.hand: FingerTarget(APPROACH_OPENING) for grasp in grasps}
    yield from _approach_grasps(context, grasps)
    _check_fingers(context, grasps)
    yield context.make_segment({grasp.hand: context.plan_line(grasp.hand, grasp.T_grasp) for grasp in grasps})
    yield from _close_with_retries(context, thing, grasps)
    missed = [grasp.hand for grasp in grasps if grasp.hand.side not in context.world.holding_sides(thing)]
    if not missed:
        yield context.make_segment(_plan_arch_paths(context, thing, grasps, arch, speed))
        yield rest_segment(context)
    yield context.make_segment(
        {hand: context.hold_still_motion(hand, CLOSING_TICKS) for hand in opened}, opened, wait_for_arrival=False
    )
    # A hand that pulled a single layer is above the cloth, unless a finger slipped under the edge.
    beneath = context.world.sides_with_finger_under_cloth(thing)
    under = (
        [] if missed else [grasp for grasp in grasps if not grasp.placement.single_layer or grasp.hand.side in beneath]
    )
    if under:
        yield context.make_segment(
            {grasp.hand: _retreat_path(context, grasp) for grasp in under}, wait_for_arrival=False
        )
    up = {}
    for hand in opened:
        T_up = hand.pinch_pose(hand.joints)
        T_up[2, 3] += APPROACH_DISTANCE
        up[hand] = context.plan_line(hand, T_up)
    yield context.make_segment(up, wait_for_arrival=False)
    if missed:
        sides = " and the ".join(sorted(hand.side for hand in missed))
        raise SkillFailedError(FailureCause.SLIPPED, f"the {sides} hand missed its corner of the {thing}")


def _approach_grasps(context: PlanningContext, grasps: Sequence[PointGrasp]) -> Iterator[MotionSegment]:
    """Move grasping hands to their approaches and idle hands away, at the same time if no paths collide."""
    opened = {grasp.hand: FingerTarget(APPROACH_OPENING) for grasp in grasps}
    goals = {hand: hand.ready_joints for hand in unparked_hands(context) if hand not in opened}
    goals |= {grasp.hand: grasp.approach_joints for grasp in grasps}
    paths = {hand: context.plan_free_path(hand, goal, APPROACH_OPENING) for hand, goal in goals.items()}
    if _are_paths_collision_free(context, paths):
        yield context.make_segment(paths, opened, wait_for_arrival=False)
        return
    for hand, goal in goals.items():
        fingers = {hand: opened[hand]} if hand in opened else {}
        yield context.make_segment(
            {hand: context.plan_free_path(hand, goal, APPROACH_OPENING)}, fingers, wait_for_arrival=False
        )


def _check_fingers(context: PlanningContext, grasps: Sequence[PointGrasp]) -> None:
    """Fingers that are stuck open would also grasp cloth that stands up beside a point."""
    for grasp in grasps:
        if context.finger_opening(grasp.hand) > _MAX_OPEN_OPENING:
            raise SkillFailedError(FailureCause.SLIPPED, f"the {grasp.hand.side} hand's fingers do not close")


def _are_paths_collision_free(context: PlanningContext, paths: Mapping[Hand, Array]) -> bool:
    ticks = max(len(path) for path in paths.values())
    for tick in range(ticks):
        there = [(hand, path[min(tick, len(path) - 1)]) for hand, path in paths.items()]
        if not all(are_hands_clear(context, one, other) for one, other in itertools.combinations(there, 2)):
            return False
    return True


def _close_with_retries(context: PlanningContext, thing: str, grasps: Sequence[PointGrasp]) -> Iterator[MotionSegment]:
    """Close hands on their points; hands that miss retry at lower heights.

    A hand misses if its arm comes to rest a little too high, or if hollow cloth gives way to its fingers.
    """
    yield from _close_fingers(context, grasps)
    points = context.world.cloth_points(thing)
    limits = {grasp.hand: _max_retry_depth(points, grasp) for grasp in grasps}
    for depth in RETRY_DEPTHS:
        holders = context.world.holding_sides(thing)
        retried = [
            grasp
            for grasp in grasps
            if grasp.hand.side not in holders
            and depth - _DEPTH_STEP < limits[grasp.hand]
            and _fingers_closed(context, grasp.hand)
        ]
        if not retried:
            return
        opened = {grasp.hand: FingerTarget(APPROACH_OPENING) for grasp in retried}
        yield context.make_segment({hand: context.hold_still_motion(hand, _OPEN_TICKS) for hand in opened}, opened)
        lines = {}
        for grasp in retried:
            lower = grasp.T_grasp.copy()
            lower[2, 3] -= min(depth, limits[grasp.hand])
            lines[grasp.hand] = context.plan_line(grasp.hand, lower)
        yield context.make_segment(lines)
        yield from _close_fingers(context, retried)


def _max_retry_depth(points: Array, grasp: PointGrasp) -> float:
    """Return the depth of a retry, m, at which the tips reach what is under the cloth."""
    hollow = float(points[grasp.placement.point][2] - points[..., 2].min()) if grasp.placement.single_layer else 0.0
    return hollow + TIP_CLEARANCE


def _close_fingers(context: PlanningContext, grasps: Sequence[PointGrasp]) -> Iterator[MotionSegment]:
    closing = {grasp.hand: FingerTarget(0.0, _CLOTH_GRIP_FORCE) for grasp in grasps}
    yield context.make_segment({hand: context.hold_still_motion(hand, CLOSING_TICKS) for hand in closing}, closing)
    yield rest_segment(context)


def _fingers_closed(context: PlanningContext, hand: Hand) -> bool:
    return context.finger_opening(hand) < _MAX_CLOSED_OPENING


def _retreat_path(context: PlanningContext, grasp: PointGrasp) -> Array:
    for direction in (grasp.lateral, grasp.forward):
        T = grasp.hand.pinch_pose(grasp.hand.joints)
        T[:2, 3] += _RETREAT_DISTANCE * direction
        T[2, 3] += _RETREAT_DISTANCE / 4
        try:
            return context.plan_line(grasp.hand, T)
        except SkillFailedError:
            continue
    return context.hold_still_motion(grasp.hand, 1)


def _plan_arch_paths(
    context: PlanningContext, thing: str, grasps: Sequence[PointGrasp], arch: float, speed: float
) -> dict[Hand, Array]:
    points = context.world.cloth_points(thing)
    low, high = context.world.local_box(thing)
    ends = {}
    for grasp in grasps:
        T_now, point = grasp.hand.pinch_pose(grasp.hand.joints), points[grasp.placement.point]
        in_pinch = T_now[:3, :3].T @ (point - T_now[:3, 3])
        # A folded point comes down onto all layers at the target; a point that is pulled alone stays low.
        over = np.array([0.0, 0.0, _PULL_HEIGHT if grasp.placement.single_layer else high[2] - low[2] + _DROP_HEIGHT])
        ends[grasp.hand] = (
            T_now,
            pose(grasp.placement.target(points) + over - grasp.R_hand_at_end @ in_pinch, grasp.R_hand_at_end),
        )
    length = max(float(np.linalg.norm((T_end - T_now)[:2, 3])) for T_now, T_end in ends.values())
    return {
        hand: context.plan_curve(hand, partial(_arch_pose, *both, arch * length), length / speed)
        for hand, both in ends.items()
    }


def _arch_pose(T_start: Array, T_end: Array, height: float, share: float) -> Array:
    path, across = T_end[:3, 3] - T_start[:3, 3], (1 - math.cos(math.pi * share)) / 2
    up = path[2] * share + height * math.sin(math.pi * share)
    R = interpolate_rotation(T_start[:3, :3], T_end[:3, :3], across)
    return pose(T_start[:3, 3] + [*(path[:2] * across), up], R)
