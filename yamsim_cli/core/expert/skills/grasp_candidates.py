from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...config.objects.object_config import ObjectConfig
from ...geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ...sim.antipodal import AntipodalPair

# rad, tilts about the closing axis, in the order tried. Flat pads press on the same two points for each. For an object
# that lies on its side, a quarter turn is the grasp from above.
_TILT_ANGLES = tuple(math.radians(angle) for angle in (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90, -90))

# rad, tilts from straight down, in the order tried, and headings of the tilt (object frame)
WELD_TILT_ANGLES = tuple(math.radians(angle) for angle in (0, 15, 30, 45))
WELD_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))

# Grasps of narrow objects beside a wall: the hand tilts to the side, along the closing axis, which leaves room for it.
# The object turns in the pads until it lies flat in them.
_SIDE_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 35, -35, 50, -50, 70, -70, 90, -90))
# m: largest half width of such an object, clearance of each finger, and retreat of the hand along its axis
_MAX_NARROW_HALF_WIDTH, _SIDE_CLEARANCE, _SIDE_RAISE = 0.010, 0.004, 0.004

# Fingertip grasps, for places where even a tilted hand finds no room. m: offset of the hand from the object's middle
# before closing; least distance of fingers from other objects.
_FINGERTIP_OFFSET, _FINGERTIP_DISTANCE = 0.0025, 0.0015
_FINGERTIP_RETREATS = (_SIDE_RAISE, 2 * _SIDE_RAISE)  # m, retreats of the hand along its axis, in the order tried

# Directions in which an arm that stands on the table can point its fingers.
_MAX_UPWARD = 0.3  # sine of the fingers' angle above horizontal
_MAX_BACKWARD = -0.5  # cosine of the fingers' horizontal angle to the direction away from the base

# For objects whose config has no grasp.
DEFAULT_FINGER_CLEARANCE = 0.010  # m, additional opening of each finger before closing and after release
_DEFAULT_FORCE = 15.0  # N, of each finger

_MAX_PAIRS = 12  # antipodal pairs that are tried; each adds 16 candidates
_MIN_PAIR_DISTANCE = 0.015  # m; of pairs with nearer middles and similar directions, only the first is tried
_APPROACH_ANGLES = tuple(math.radians(angle) for angle in range(0, 360, 45))  # rad, about the closing line


@dataclass(frozen=True, eq=False)
class GraspCandidate:
    """A pose of the hand relative to an object, with the opening and the force of the fingers.

    Attributes:
        T_pinch_in_thing: z points along the approach, y along the closing axis.
        opening: of each finger when it touches the object, m.
        clearance: additional opening of each finger before closing and after release, m.
        force: of each finger, N.
        finger_distance: least distance of the fingers from other objects, m; None for the arm's distance.
    """

    T_pinch_in_thing: Array
    opening: float
    clearance: float
    force: float
    finger_distance: float | None = None


def friction_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield the friction grasps at the grasp points of an object's config, least tilt first."""
    points = list(_grasp_points(item))
    for lean in _TILT_ANGLES:
        for T, opening, clearance, force in points:
            for turn in (0.0, math.pi):
                tilted = pose(rotation=rotation_z(turn) @ rotation_from_vector([0.0, lean, 0.0]))
                yield GraspCandidate(T @ tilted, opening, clearance, force)


def weld_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield the weld grasps at the grasp points of an object's config, least tilt first.

    A weld holds in any direction, so the hand tilts as suits the arm. A grasp point with `tilt_deg` fixes the hand's
    direction, because the pads lie on a sloped wall there.
    """
    grasp = item.grasp
    if grasp is None:
        return
    points = (grasp, *(grasp.friction.points if grasp.friction is not None else ()))
    for lean in WELD_TILT_ANGLES:
        for point in points:
            T = point.T_pinch_in_object(flipped=False)
            for heading in WELD_HEADINGS if lean and point.tilt_deg is None else (0.0,):
                axis = np.array((math.sin(heading), -math.cos(heading), 0.0))
                R = rotation_from_vector(lean * axis) if point.tilt_deg is None else np.eye(3)
                for turn in (0.0, math.pi):
                    T_tilted = pose(T[:3, 3], R @ T[:3, :3] @ rotation_z(turn))
                    yield GraspCandidate(T_tilted, point.opening, grasp.clearance, 0.0)


def sideways_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield grasps of a narrow object beside a wall, with a hand that tilts to the side."""
    points = [point for point in _grasp_points(item) if point[1] <= _MAX_NARROW_HALF_WIDTH]
    for tilt in _SIDE_TILTS:
        for T, opening, clearance, force in points:
            for lean in _TILT_ANGLES[:5]:
                for turn in (0.0, math.pi):
                    turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_z(turn)
                    tilted = pose((0.0, 0.0, -_SIDE_RAISE), turned @ rotation_from_vector([0.0, lean, 0.0]))
                    yield GraspCandidate(T @ tilted, opening, min(clearance, _SIDE_CLEARANCE), force)


def antipodal_candidates(item: ObjectConfig, spans: Sequence[AntipodalPair]) -> Iterator[GraspCandidate]:
    """Yield grasps at antipodal pairs, with approaches all around each closing line."""
    grasp = item.grasp
    force = grasp.friction.force if grasp is not None and grasp.friction is not None else _DEFAULT_FORCE
    clearance = grasp.clearance if grasp is not None else DEFAULT_FINGER_CLEARANCE
    for pair in _distinct_pairs(spans):
        x = np.cross(pair.direction, (0.0, 0.0, 1.0) if abs(pair.direction[2]) < 0.9 else (1.0, 0.0, 0.0))
        x /= np.linalg.norm(x)
        frame = np.column_stack([x, pair.direction, np.cross(x, pair.direction)])
        for angle in _APPROACH_ANGLES:
            T = pose(pair.middle, frame @ rotation_from_vector([0.0, angle, 0.0]))
            for turn in (0.0, math.pi):
                yield GraspCandidate(T @ pose(rotation=rotation_z(turn)), pair.width / 2, clearance, force)


def fingertip_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield grasps of a narrow object beside a wall by the fingertips, one of them close to it."""
    points = [point for point in _grasp_points(item) if point[1] <= _MAX_NARROW_HALF_WIDTH]
    for raised, tilt in itertools.product(_FINGERTIP_RETREATS, _SIDE_TILTS):
        for T, opening, clearance, force in points:
            for lean, turn, side in itertools.product(_TILT_ANGLES[:3], (0.0, math.pi), (-1.0, 1.0)):
                turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_z(turn)
                tilted = pose(rotation=turned @ rotation_from_vector([0.0, lean, 0.0]))
                offset = pose((0.0, side * _FINGERTIP_OFFSET, -raised))
                yield GraspCandidate(
                    T @ tilted @ offset, opening, min(clearance, _SIDE_CLEARANCE), force, _FINGERTIP_DISTANCE
                )


def _distinct_pairs(spans: Sequence[AntipodalPair]) -> list[AntipodalPair]:
    kept: list[AntipodalPair] = []
    for pair in spans:
        if len(kept) == _MAX_PAIRS:
            break
        if all(
            np.linalg.norm(pair.middle - other.middle) > _MIN_PAIR_DISTANCE
            or abs(pair.direction @ other.direction) < 0.9
            for other in kept
        ):
            kept.append(pair)
    return kept


def _grasp_points(item: ObjectConfig) -> Iterator[tuple[Array, float, float, float]]:
    if item.grasp is not None and item.grasp.friction is not None:
        for point in item.grasp.friction.points:
            T = point.T_pinch_in_object(flipped=False)
            yield T, point.opening, item.grasp.clearance, item.grasp.friction.force


def is_orientation_plausible(T_pinch_in_world: Array, T_base_in_world: Array) -> bool:
    """Return whether an arm can point its fingers as in a pose: a quick test before inverse kinematics."""
    forward, away = T_pinch_in_world[:3, 2], (T_pinch_in_world - T_base_in_world)[:2, 3]
    if forward[2] > _MAX_UPWARD:
        return False
    horizontal = math.hypot(forward[0], forward[1])
    distance = math.hypot(away[0], away[1])
    return horizontal < 0.5 or distance < 1e-6 or float(forward[:2] @ away) / (horizontal * distance) > _MAX_BACKWARD
