from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector, rotation_z

from ..hand import WAYPOINT_TOLERANCE, Hand
from ..planning_context import PlanningContext

APPROACH_OPENING = 0.012  # m, of each finger, before it closes on cloth
TIP_CLEARANCE = 0.001  # m, of tips over a grasped point: tips press on the cloth, and do not touch what is under it
APPROACH_DISTANCE = 0.08  # m, length of a hand's straight approach

HALF_PAD, _HALF_WIDTH = 0.0082, 0.0072  # m, half the length of a pad, which ends at the tip, and half its width
_GRASP_INSET = (
    0.007  # m, offset of a grasp from its point towards the middle of the cloth, so that both pads meet cloth
)

# Cloth that stands up between the two squares below ends up on a finger.
_HALF_HAND_SIZE = 0.024  # m, half the side of the square that an open hand needs around its middle
_HALF_FINGER_GAP_SIZE = (0.009, 0.011)  # m, half the sides of the gap between open fingers, which cloth may fill
_MAX_STANDING_HEIGHT = 0.03  # m, over the tips, of cloth beside the fingers

_NEIGHBOUR_CELLS = (
    2  # cells; neighbours this near to a point of an upper layer give the direction to the layer's middle
)
_OVERLAP_DISTANCE = 0.012  # m, horizontal distance below which points lie on each other
_CONTACT_CHECK_HEIGHT = 0.03  # m over the grasp at which contacts of the hand are checked
_HAND_TILTS = tuple(math.radians(angle) for angle in (0, 15, 30, 45))  # rad, of a hand to its arm, in the order tried

# Target (3,) of a point in `world`, m, given the cloth's points (along y, along x, 3) at the grasp.
PointTarget = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class PointPlacement:
    """A point of cloth to grasp, by row and column, and its target; if `single_layer`, without the layers below it."""

    point: tuple[int, int]
    target: PointTarget
    single_layer: bool = False


@dataclass(frozen=True, eq=False)
class PointGrasp:
    """A hand's grasp of a point of cloth.

    Attributes:
        T_grasp: pose of the pinch frame at the point.
        R_hand_at_end: rotation of the pinch frame at the target.
        approach_joints, joints_at_end: joints (dof,) before the approach, and over the target, rad.
        forward: horizontal direction (2,) of the motion.
        lateral: direction (2,) out from under the cloth, across the motion, or outwards for a point grasped alone.
    """

    hand: Hand
    placement: PointPlacement
    T_grasp: Array
    R_hand_at_end: Array
    approach_joints: Array
    joints_at_end: Array
    forward: Array
    lateral: Array


def target_at_place(place: Array) -> PointTarget:
    """Return the target at a fixed position (3,) in `world`, m."""
    return lambda points: place


def target_on_point(point: tuple[int, int]) -> PointTarget:
    """Return a target on another point of the cloth, by its row and column."""
    return lambda points: points[point]


def reachable_grasps(
    context: PlanningContext, thing: str, placements: Sequence[PointPlacement], points: Array | None = None
) -> list[PointGrasp] | None:
    """Return grasps of a cloth's points by free hands, one for each point; None if a point or target is out of reach.

    `points` (along y, along x, 3) are in `world`, m; the present ones by default.
    """
    points = context.world.cloth_points(thing) if points is None else points
    free = context.free_hands("any")
    for hands in itertools.permutations(free, len(placements)):
        # Arms do not cross: the left arm's hand grasps the left point.
        sides = [hand.arm.T_base_in_world[1, 3] for hand in hands]
        places = [points[placement.point][1] for placement in placements]
        if len(placements) > 1 and (sides[0] - sides[1]) * (places[0] - places[1]) <= 0:
            continue
        grasps: list[PointGrasp] = []
        for hand, placement in zip(hands, placements, strict=True):
            if (grasp := _point_grasp(context, hand, points, placement)) is None:
                break
            grasps.append(grasp)
        if len(grasps) == len(placements) and _hands_stay_clear(context, grasps):
            return grasps
    return None


def _point_grasp(context: PlanningContext, hand: Hand, points: Array, placement: PointPlacement) -> PointGrasp | None:
    """Return a hand's grasp with the least tilt that reaches the point and its target."""
    place = points[placement.point]
    path = placement.target(points) - place
    middle = place[:2] + path[:2] / 2
    away = middle - hand.arm.T_base_in_world[:2, 3]
    heading = math.atan2(away[1], away[0])
    inwards = _direction_to_middle(
        place, _neighbouring_points(points, placement.point) if placement.single_layer else points.reshape(-1, 3)
    )
    forward = path[:2] / max(float(np.linalg.norm(path[:2])), 1e-9)
    lateral = -inwards if placement.single_layer else (inwards @ forward) * forward - inwards
    # Fingers point down, and close across the direction from the arm, so that a tilt keeps both tips at one height.
    level = rotation_z(heading + math.pi) @ np.diag([1.0, -1.0, -1.0])
    turns = [
        rotation_from_vector((tilt * math.sin(heading), -tilt * math.cos(heading), 0.0)) @ level for tilt in _HAND_TILTS
    ]
    for tilt, R in zip(_HAND_TILTS, turns, strict=True):
        up = HALF_PAD * math.cos(tilt) + _HALF_WIDTH * math.sin(tilt) + TIP_CLEARANCE
        up -= 0.0 if placement.single_layer else _height_over_lowest(points, place)
        T_at = pose((*(place[:2] + _GRASP_INSET * inwards), place[2] + up), R)
        if placement.single_layer and _cloth_stands_beside(points, T_at):
            continue
        T_near = T_at.copy()
        T_near[2, 3] += _CONTACT_CHECK_HEIGHT
        near = hand.solve_ik(T_near, (hand.ready_joints,), WAYPOINT_TOLERANCE)
        at = None if near is None else hand.solve_ik(T_at, (near,))
        if near is None or at is None or context.collision_checker.has_self_collision(hand.number, at):
            continue
        before = hand.solve_ik(T_at @ pose((0.0, 0.0, -APPROACH_DISTANCE)), (near,), WAYPOINT_TOLERANCE)
        if (
            before is None
            or context.find_contact(hand, near, APPROACH_OPENING)
            or context.find_contact(hand, before, APPROACH_OPENING)
        ):
            continue
        for R_hand_at_end in (R, *(turn for turn in turns if turn is not R)):
            end = hand.solve_ik(pose(T_near[:3, 3] + [*path[:2], 0.0], R_hand_at_end), (near,), WAYPOINT_TOLERANCE)
            if end is not None and not context.collision_checker.has_self_collision(hand.number, end):
                return PointGrasp(hand, placement, T_at, R_hand_at_end, before, end, forward, lateral)
    return None


def _cloth_stands_beside(points: Array, T_at: Array) -> bool:
    seen = (points.reshape(-1, 3) - T_at[:3, 3]) @ T_at[:3, :3]
    across = np.abs(seen[:, :2])
    beside = (across < _HALF_HAND_SIZE).all(axis=1) & ~(across < _HALF_FINGER_GAP_SIZE).all(axis=1)
    return bool((HALF_PAD - seen[beside, 2] > _MAX_STANDING_HEIGHT).any())


def _height_over_lowest(points: Array, place: Array) -> float:
    flat = points.reshape(-1, 3)
    there = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _OVERLAP_DISTANCE
    return float(place[2] - flat[there, 2].min())


def _direction_to_middle(place: Array, others: Array) -> Array:
    inwards: Array = others.mean(axis=0)[:2] - place[:2]
    inwards /= np.linalg.norm(inwards)
    return inwards


def _neighbouring_points(points: Array, point: tuple[int, int]) -> Array:
    row, column = point
    near = points[
        max(0, row - _NEIGHBOUR_CELLS) : row + _NEIGHBOUR_CELLS + 1,
        max(0, column - _NEIGHBOUR_CELLS) : column + _NEIGHBOUR_CELLS + 1,
    ]
    return near.reshape(-1, 3)


def _hands_stay_clear(context: PlanningContext, grasps: Sequence[PointGrasp]) -> bool:
    if len(grasps) < 2:
        return True
    ends = [
        [(grasp.hand, grasp.approach_joints) for grasp in grasps],
        [(grasp.hand, grasp.joints_at_end) for grasp in grasps],
    ]
    return all(are_hands_clear(context, *both) for both in ends)


def are_hands_clear(context: PlanningContext, one: tuple[Hand, Array], other: tuple[Hand, Array]) -> bool:
    """Return whether hands at joints (dof,) do not touch each other, with fingers at least open for an approach."""
    (hand, joints), (other_hand, other_joints) = one, other
    there = context.qpos_with_hand(hand, joints, max(APPROACH_OPENING, hand.opening), None)
    return (
        context.collision_checker.find_contact(
            there, other_hand.number, other_joints, max(APPROACH_OPENING, other_hand.opening)
        )
        is None
    )
