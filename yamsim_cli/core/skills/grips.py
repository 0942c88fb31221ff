"""The ways in which a hand can hold a thing: those that its config names, and those that its shape offers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..config.things.thing import ObjectConfig
from ..geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ..sim.antipodal import Span

# How far a hand may lean about the axis along which its fingers close, in the order in which that is tried. So turned,
# flat pads press on the same two places. Of a thing that lies on its side, a quarter turn is what comes from above.
_LEANS = tuple(math.radians(angle) for angle in (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90, -90))

# rad, how far a hand that holds by a weld leans from straight down, in the order in which that is tried, and towards
# which headings in the thing's frame
WELD_LEANS = tuple(math.radians(angle) for angle in (0, 15, 30, 45))
WELD_HEADINGS = tuple(math.radians(angle) for angle in range(0, 360, 45))

# How far a hand may lean to the side, along the axis on which its fingers close, about something as narrow as this, as
# half its width, m: it turns in the pads until it lies flat in them. So a wall beside it leaves room for the hand. Its
# fingers come but so far from the thing, m, and hold it so much raised.
_SIDE_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 35, -35, 50, -50, 70, -70, 90, -90))
_MAX_NARROW, _SIDE_CLEARANCE, _SIDE_RAISE = 0.010, 0.004, 0.004

# Where even that finds no room: so far off the thing's middle a hand may be before it closes, so near its fingers may
# come to what stands beside, and so much raised they hold, m.
_FINGERTIP_OFFSET, _FINGERTIP_DISTANCE = 0.0025, 0.0015
_FINGERTIP_RAISES = (_SIDE_RAISE, 2 * _SIDE_RAISE)

# No arm that stands on the table points its fingers farther up than this, as the sine of the angle; nor farther back
# towards its base, as the cosine of the angle to what leads away from it.
_MAX_UPWARD = 0.3
_MAX_BACKWARD = -0.5

# Of things that do not say, m and N.
CLEARANCE = 0.010
_DEFAULT_FORCE = 15.0

# Of the places that a thing's own shape offers: how many are tried, how far apart they are, m, and from where around
# the line on which the fingers close.
_MAX_SPANS = 12
_SPAN_DISTANCE = 0.015
_APPROACH_ANGLES = tuple(math.radians(angle) for angle in range(0, 360, 45))


@dataclass(frozen=True, eq=False)
class Grip:
    """One way to hold a thing.

    Attributes:
        T_pinch_in_thing: the pinch frame (4, 4) in the thing's: z into the grasp, y along the closing direction.
        opening: of one finger around the thing, m.
        clearance: how much wider each finger is before it closes and after it opened, m.
        force: with which each finger presses, N.
        finger_distance: how near its fingers may come to other things, m; without, no nearer than the rest of the arm.
    """

    T_pinch_in_thing: Array
    opening: float
    clearance: float
    force: float
    finger_distance: float | None = None


def friction_grips(item: ObjectConfig) -> Iterator[Grip]:
    """The ways to hold a thing by friction, the hand leaning less before it leans more."""
    points = list(_grasp_points(item))
    for lean in _LEANS:
        for T, opening, clearance, force in points:
            for turn in (0.0, math.pi):
                leaning = pose(rotation=rotation_z(turn) @ rotation_from_vector([0.0, lean, 0.0]))
                yield Grip(T @ leaning, opening, clearance, force)


def weld_grips(item: ObjectConfig) -> Iterator[Grip]:
    """Yield the ways to hold a thing by a weld, the hand leaning less before it leans more, and to all sides.

    A weld holds in any direction, so the hand leans as suits the arm. Where the config says that pads lie on a leaning
    wall, the hand stays as it says.
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
                    yield Grip(T_leaning, point.opening, grasp.clearance, 0.0)


def sideways_grips(item: ObjectConfig) -> Iterator[Grip]:
    """The ways to hold something narrow with a hand that leans to the side: for places beside a wall."""
    points = [point for point in _grasp_points(item) if point[1] <= _MAX_NARROW]
    for tilt in _SIDE_TILTS:
        for T, opening, clearance, force in points:
            for lean in _LEANS[:5]:
                for turn in (0.0, math.pi):
                    turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_z(turn)
                    leaning = pose((0.0, 0.0, -_SIDE_RAISE), turned @ rotation_from_vector([0.0, lean, 0.0]))
                    yield Grip(T @ leaning, opening, min(clearance, _SIDE_CLEARANCE), force)


def antipodal_grips(item: ObjectConfig, spans: Sequence[Span]) -> Iterator[Grip]:
    """The ways to hold a thing at the ends of lines through it, the hand coming from all around each line."""
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
                yield Grip(T @ pose(rotation=rotation_z(turn)), span.width / 2, clearance, force)


def fingertip_grips(item: ObjectConfig) -> Iterator[Grip]:
    """The ways to hold something narrow with the ends of the fingers, one of them close to it: for places beside a wall
    where nothing else goes.
    """
    points = [point for point in _grasp_points(item) if point[1] <= _MAX_NARROW]
    for raised, tilt in itertools.product(_FINGERTIP_RAISES, _SIDE_TILTS):
        for T, opening, clearance, force in points:
            for lean, turn, side in itertools.product(_LEANS[:3], (0.0, math.pi), (-1.0, 1.0)):
                turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_z(turn)
                leaning = pose(rotation=turned @ rotation_from_vector([0.0, lean, 0.0]))
                off = pose((0.0, side * _FINGERTIP_OFFSET, -raised))
                yield Grip(T @ leaning @ off, opening, min(clearance, _SIDE_CLEARANCE), force, _FINGERTIP_DISTANCE)


def _distinct_spans(spans: Sequence[Span]) -> list[Span]:
    """The best spans that differ from each other in where they are, or along which direction they go."""
    kept: list[Span] = []
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
    """Pinch frame (4, 4), opening, clearance and force of each place where a thing can be held."""
    if item.grasp is not None and item.grasp.friction is not None:
        for point in item.grasp.friction.points:
            T = point.T_pinch_in_object(flipped=False)
            yield T, point.opening, item.grasp.clearance, item.grasp.friction.force


def can_point(T_pinch_in_world: Array, T_base_in_world: Array) -> bool:
    """Whether a hand at a pose (4, 4) would point where an arm's hand can point: a look before kinematics."""
    forward, away = T_pinch_in_world[:3, 2], (T_pinch_in_world - T_base_in_world)[:2, 3]
    if forward[2] > _MAX_UPWARD:
        return False
    horizontal = math.hypot(forward[0], forward[1])
    distance = math.hypot(away[0], away[1])
    return horizontal < 0.5 or distance < 1e-6 or float(forward[:2] @ away) / (horizontal * distance) > _MAX_BACKWARD
