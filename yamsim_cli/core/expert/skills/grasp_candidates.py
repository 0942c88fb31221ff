"""Candidate grips of a thing: those that its config names, and those that its shape offers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...config.objects.object_config import ObjectConfig
from ...geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ...sim.antipodal import AntipodalPair

# rad, leans of the hand about the closing axis, in the order tried. Flat pads press on the same two places for each.
# For a thing that lies on its side, a quarter turn is the grasp from above.
_LEANS = tuple(math.radians(angle) for angle in (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90, -90))

# rad, leans from straight down of a hand with a weld, in the order tried, and the headings of the lean in the thing's
# frame
WELD_LEANS = tuple(math.radians(angle) for angle in (0, 15, 30, 45))
WELD_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))

# Grips of narrow things beside a wall: the hand tilts to the side, along the closing axis, which leaves room for the
# hand. The thing turns in the pads until it lies flat in them.
_SIDE_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 35, -35, 50, -50, 70, -70, 90, -90))
# m: largest half width of such a thing, clearance of each finger, and how much higher the hand grasps
_MAX_NARROW, _SIDE_CLEARANCE, _SIDE_RAISE = 0.010, 0.004, 0.004

# Fingertip grips, for places where even a tilted hand finds no room.
# m: offset of the hand from the thing's middle before closing; least distance of fingers to others
_FINGERTIP_OFFSET, _FINGERTIP_DISTANCE = 0.0025, 0.0015
_FINGERTIP_RAISES = (_SIDE_RAISE, 2 * _SIDE_RAISE)  # m, how much higher the fingertips grasp, in the order tried

# Directions in which an arm that stands on the table can point its fingers.
_MAX_UPWARD = 0.3  # largest sine of the angle above horizontal
_MAX_BACKWARD = -0.5  # least cosine of the horizontal angle to the direction away from the base

# Defaults for things whose config has no grasp.
CLEARANCE = 0.010  # m, of each finger
_DEFAULT_FORCE = 15.0  # N, of each finger

# Antipodal grips, found from the thing's shape.
_MAX_SPANS = 12  # count, how many different spans are tried; each adds 16 grips
_SPAN_DISTANCE = 0.015  # m, spans with middles nearer than this and similar directions count as the same
_APPROACH_ANGLES = tuple(math.radians(angle) for angle in range(0, 360, 45))  # rad, of the hand about the closing line


@dataclass(frozen=True, eq=False)
class GraspCandidate:
    """A pose of the hand relative to a thing, and how the fingers close there.

    Attributes:
        T_pinch_in_thing: the pinch frame (4, 4) in the thing's: z points into the grasp, y along the closing axis.
        opening: of each finger around the thing, m.
        clearance: additional opening of each finger before closing and after release, m.
        force: of each finger, N.
        finger_distance: least distance of the fingers to other things, m; None for that of the rest of the arm.
    """

    T_pinch_in_thing: Array
    opening: float
    clearance: float
    force: float
    finger_distance: float | None = None


def friction_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield the grips at a config's grasp points that hold by friction, those with the least lean first."""
    points = list(_grasp_points(item))
    for lean in _LEANS:
        for T, opening, clearance, force in points:
            for turn in (0.0, math.pi):
                leaning = pose(rotation=rotation_z(turn) @ rotation_from_vector([0.0, lean, 0.0]))
                yield GraspCandidate(T @ leaning, opening, clearance, force)


def weld_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield the grips at a config's grasp points that hold by a weld, those with the least lean first.

    A weld holds in any direction, so the hand leans as suits the arm. A grasp point with `tilt_deg` fixes the hand's
    direction, because the pads lie on a leaning wall there.
    """
    grasp = item.grasp
    if grasp is None:
        return
    points = (grasp, *(grasp.friction.points if grasp.friction is not None else ()))
    for lean in WELD_LEANS:
        for point in points:
            T = point.T_pinch_in_object(flipped=False)
            for heading in WELD_HEADINGS if lean and point.tilt_deg is None else (0.0,):
                axis = np.array((math.sin(heading), -math.cos(heading), 0.0))
                R = rotation_from_vector(lean * axis) if point.tilt_deg is None else np.eye(3)
                for turn in (0.0, math.pi):
                    T_leaning = pose(T[:3, 3], R @ T[:3, :3] @ rotation_z(turn))
                    yield GraspCandidate(T_leaning, point.opening, grasp.clearance, 0.0)


def sideways_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield grips of a narrow thing with a hand that tilts to the side, for places beside a wall."""
    points = [point for point in _grasp_points(item) if point[1] <= _MAX_NARROW]
    for tilt in _SIDE_TILTS:
        for T, opening, clearance, force in points:
            for lean in _LEANS[:5]:
                for turn in (0.0, math.pi):
                    turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_z(turn)
                    leaning = pose((0.0, 0.0, -_SIDE_RAISE), turned @ rotation_from_vector([0.0, lean, 0.0]))
                    yield GraspCandidate(T @ leaning, opening, min(clearance, _SIDE_CLEARANCE), force)


def antipodal_candidates(item: ObjectConfig, spans: Sequence[AntipodalPair]) -> Iterator[GraspCandidate]:
    """Yield grips at the ends of spans through a thing, with approach directions all around each span."""
    grasp = item.grasp
    force = grasp.friction.force if grasp is not None and grasp.friction is not None else _DEFAULT_FORCE
    clearance = grasp.clearance if grasp is not None else CLEARANCE
    for span in _distinct_spans(spans):
        x = np.cross(span.direction, (0.0, 0.0, 1.0) if abs(span.direction[2]) < 0.9 else (1.0, 0.0, 0.0))
        x /= np.linalg.norm(x)
        frame = np.column_stack([x, span.direction, np.cross(x, span.direction)])
        for angle in _APPROACH_ANGLES:
            T = pose(span.middle, frame @ rotation_from_vector([0.0, angle, 0.0]))
            for turn in (0.0, math.pi):
                yield GraspCandidate(T @ pose(rotation=rotation_z(turn)), span.width / 2, clearance, force)


def fingertip_candidates(item: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield grips of a narrow thing with the fingertips and one finger close to it, for places beside a wall."""
    points = [point for point in _grasp_points(item) if point[1] <= _MAX_NARROW]
    for raised, tilt in itertools.product(_FINGERTIP_RAISES, _SIDE_TILTS):
        for T, opening, clearance, force in points:
            for lean, turn, side in itertools.product(_LEANS[:3], (0.0, math.pi), (-1.0, 1.0)):
                turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_z(turn)
                leaning = pose(rotation=turned @ rotation_from_vector([0.0, lean, 0.0]))
                off = pose((0.0, side * _FINGERTIP_OFFSET, -raised))
                yield GraspCandidate(
                    T @ leaning @ off, opening, min(clearance, _SIDE_CLEARANCE), force, _FINGERTIP_DISTANCE
                )


def _distinct_spans(spans: Sequence[AntipodalPair]) -> list[AntipodalPair]:
    """Return the best spans that differ from each other in position or direction."""
    kept: list[AntipodalPair] = []
    for span in spans:
        if len(kept) == _MAX_SPANS:
            break
        if all(
            np.linalg.norm(span.middle - other.middle) > _SPAN_DISTANCE or abs(span.direction @ other.direction) < 0.9
            for other in kept
        ):
            kept.append(span)
    return kept


def _grasp_points(item: ObjectConfig) -> Iterator[tuple[Array, float, float, float]]:
    """Yield the pinch frame (4, 4), opening, clearance and force of each grasp point of a config."""
    if item.grasp is not None and item.grasp.friction is not None:
        for point in item.grasp.friction.points:
            T = point.T_pinch_in_object(flipped=False)
            yield T, point.opening, item.grasp.clearance, item.grasp.friction.force


def is_orientation_plausible(T_pinch_in_world: Array, T_base_in_world: Array) -> bool:
    """Return whether an arm can point its hand as in a pose (4, 4): a quick test before inverse kinematics."""
    forward, away = T_pinch_in_world[:3, 2], (T_pinch_in_world - T_base_in_world)[:2, 3]
    if forward[2] > _MAX_UPWARD:
        return False
    horizontal = math.hypot(forward[0], forward[1])
    distance = math.hypot(away[0], away[1])
    return horizontal < 0.5 or distance < 1e-6 or float(forward[:2] @ away) / (horizontal * distance) > _MAX_BACKWARD
