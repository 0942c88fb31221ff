"""Motions that bring a held vessel or tool over another vessel, and tilt it there."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.attempt_data import FailureCause
from ..core.config.goals.world import TABLE
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import ContainerShape, VesselShape
from ..core.expert.planning.collision_checker import AttachedObject
from ..core.expert.planning.trajectory import is_collision_free
from ..core.expert.skills.grasp_candidates import GraspCandidate
from ..core.expert.skills.hand import Hand
from ..core.expert.skills.pick import Pick, ReachableGrasp
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError, plan_free_path
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_z

TICKS = 10  # control ticks of a step: one action of the benchmark
_FORCE = 40.0  # N, of each finger; a carton with 500 g of pasta weighs 5.2 N, and swings between the pads
_CLEARANCE = 0.006  # m, additional opening of each finger before closing: a carton is 80 mm wide, a hand opens 95 mm
_GRASP_AZIMUTHS = 24  # directions from which a hand may grasp a round source
_GRASP_TILTS = (8, 0, 20, 30, 40)  # degrees down from horizontal, of that hand, in the order tried
_GRASP_SHARES = (0.6, 0.5, 0.7, 0.4)  # heights of that hand, as shares of the source's height

_TILT_AZIMUTHS = 16  # directions in which a round source may tilt
_TILT_STEP = math.radians(5)  # rad, between the angles of a tilt at which contacts are checked
_MAX_TILT = math.radians(145)  # rad; a source that tilts further is empty already
_MIN_TILT = math.radians(95)  # rad, least tilt that a grasp has to allow
# rad, by which the source turns about the vertical on its way to the vessel
_HEADINGS = tuple(math.radians(turn) for turn in (0, 30, -30, 60, -60, 90, -90))
_STROKE_VALUE = 2.0  # rad per m: how much tilt the stroke of shaking is worth
_MAX_JOINT_STEP = 0.6  # rad, of a joint in one step of a tilt; more is another posture
# From the vessel's rim up to the source: m at most, and as a share of the vessel's radius. A narrow cup catches pieces
# that fall from a small height.
_LIP_GAP, _LIP_GAP_SHARE = 0.03, 0.4
# Share of the vessel's radius by which the lip stays behind the middle at most. Pieces topple once half of their length
# is over the lip, so it stays behind by half their length.
_MAX_LIP_OFFSET = 0.8
# m, strokes of a shake along the source's axis, in the order tried. At the largest tilt, friction holds pieces, and a
# shake of two actions loosens them.
_SHAKES = (0.16, 0.14, 0.12, 0.10, 0.08, 0.06, 0.04, 0.02)
# m, radius of a narrow vessel, and the stroke over it: longer ones throw pieces beside it
_NARROW, _NARROW_SHAKE = 0.06, 0.04
_CARRY_SPEED = 0.25  # m/s
_UPRIGHT = math.cos(math.radians(25))  # least cosine of the tilt of a source on its way
_SAME_JOINTS = 0.05  # rad, between joints that count as the same posture
_SEARCH_SEED = 0  # of the random search for a way around


@dataclass(frozen=True)
class Tilt:
    """A motion that tilts a held object over a vessel, as its angles (n,), rad, increasing, and joints (n, dof)."""

    angles: Array
    joints: Array

    def joints_at(self, angle: float) -> Array:
        """Return the joints (dof,) at an angle, rad."""
        return np.array([np.interp(angle, self.angles, row) for row in self.joints.T])


@dataclass(frozen=True)
class PouringTilt(Tilt):
    """A tilt of a source from upright (angle 0), with a shake at its largest angle.

    `back` are joints (dof,) with which the source, at its largest angle, is drawn back along its axis by `stroke`, m.
    """

    back: Array
    stroke: float
    over_narrow_vessel: bool

    @property
    def score(self) -> float:
        """The largest angle, rad, and what the stroke of shaking is worth."""
        return float(self.angles[-1]) + _STROKE_VALUE * self.stroke


@dataclass(frozen=True)
class HeldSource:
    """A source or a tool to scoop that a hand holds, now or in a grasp that is tried.

    Attributes:
        load: the source or the tool in the hand.
        joints: of the hand (dof,), rad.
        opening: of each finger, m.
        piece_length: of its loose pieces, m.
    """

    hand: Hand
    load: AttachedObject
    joints: Array
    opening: float
    piece_length: float


def reachable_grasps(
    context: PlanningContext, picker: Pick, thing: str, candidates: Sequence[GraspCandidate], reasons: Counter[str]
) -> Iterator[tuple[Hand, ReachableGrasp]]:
    """Yield the grasps of an object that free hands reach, those of the nearest arm first.

    The reasons why hands do not reach the other grasps are counted in `reasons`.
    """
    middle = context.world.pose(thing)[:2, 3]
    hands = sorted(
        context.free_hands("any"), key=lambda hand: float(np.linalg.norm(middle - hand.arm.T_base_in_world[:2, 3]))
    )
    for hand, candidate in itertools.product(hands, candidates):
        found = picker.find_reachable_grasp(context, hand, thing, candidate)
        if isinstance(found, ReachableGrasp):
            yield hand, found
        elif found is not None:
            reasons[found] += 1


def grasps_from_side(
    source: ObjectConfig, azimuths: int = _GRASP_AZIMUTHS, shares: Sequence[float] = _GRASP_SHARES
) -> Iterator[GraspCandidate]:
    """Yield grasps of a source from the side, for hands that point horizontally or somewhat down."""
    shape = source.shape
    for share, tilt in itertools.product(shares, _GRASP_TILTS):
        down = math.radians(tilt)
        if isinstance(shape, VesselShape):
            count = azimuths
            widths = [shape.diameter_mm / 1000] * count
        else:
            assert isinstance(shape, ContainerShape), "vessels and containers are poured from"
            count = 4
            widths = [shape.size_mm[1 - k % 2] / 1000 for k in range(count)]
        for k, width in enumerate(widths):
            turn = 2 * math.pi * k / count
            x, y = math.cos(turn), math.sin(turn)
            forward = np.array([x * math.cos(down), y * math.cos(down), -math.sin(down)])
            for side in (1.0, -1.0):
                closing = side * np.array([-y, x, 0.0])
                R = np.column_stack([np.cross(closing, forward), closing, forward])
                yield GraspCandidate(pose((0.0, 0.0, share * height_of(source)), R), width / 2, _CLEARANCE, _FORCE)


def height_of(source: ObjectConfig) -> float:
    """Return a source's height, m."""
    if isinstance(source.shape, ContainerShape):
        return source.shape.size_mm[2] / 1000
    assert isinstance(source.shape, VesselShape), "vessels and containers are poured from"
    return source.shape.height_mm / 1000


def opening_radius(vessel: ObjectConfig) -> float:
    """Return the radius of a vessel's opening, or half the shorter side of a container's, m."""
    if isinstance(vessel.shape, ContainerShape):
        return min(vessel.shape.size_mm[:2]) / 2000
    assert isinstance(vessel.shape, VesselShape), "vessels and containers are poured into"
    return vessel.shape.diameter_mm / 2000


def _tilt_directions(source: ObjectConfig) -> Iterator[tuple[Array, float, float]]:
    """Yield ways to tilt a source.

    Each is a horizontal unit vector (3,) in the source's frame towards which it tilts, the lip's distance from its
    middle, m, and the angle by which it turns about the vertical on its way to the vessel, rad.
    """
    shape = source.shape
    if isinstance(shape, ContainerShape):
        for k, side, turn in itertools.product((0, 1), (1.0, -1.0), _HEADINGS):
            yield side * np.eye(3)[k], shape.size_mm[k] / 2000, turn
        return
    assert isinstance(shape, VesselShape)
    for k in range(_TILT_AZIMUTHS):
        turn = 2 * math.pi * k / _TILT_AZIMUTHS
        yield np.array([math.cos(turn), math.sin(turn), 0.0]), shape.diameter_mm / 2000, 0.0


def longest_tilt(context: PlanningContext, source: HeldSource, vessel: str) -> PouringTilt | None:
    """Return the best motion that tilts a source, held upright, over a vessel; None if none reaches `_MIN_TILT`."""
    ways = _tilt_directions(context.object_configs[source.load.thing])
    tilts = (_tilt_towards(context, source, vessel, *way) for way in ways)
    return max(filter(None, tilts), key=lambda tilt: tilt.score, default=None)


def _tilt_towards(
    context: PlanningContext, source: HeldSource, vessel: str, direction: Array, lip: float, turn: float
) -> PouringTilt | None:
    """Return the motion that tilts a held source over a vessel as far as possible; None if that is not far enough.

    `direction`, `lip` and `turn` are as in `_tilt_directions`.
    """
    hand, T_thing_in_pinch = source.hand, source.load.T_thing_in_pinch
    target = context.object_configs[vessel]
    radius, rim = opening_radius(target), height_of(target)
    tall = height_of(context.object_configs[source.load.thing])
    T_vessel, table = context.world.pose(vessel), float(context.world.aabb(TABLE)[1][2])
    R = rotation_z(turn) @ (hand.pinch_pose(source.joints) @ T_thing_in_pinch)[:3, :3]
    towards = R @ direction
    towards[2] = 0.0
    towards /= np.linalg.norm(towards)
    axis = np.cross([0.0, 0.0, 1.0], towards)
    offset = min(source.piece_length / 2, _MAX_LIP_OFFSET * radius)
    behind = _edge_distance(context, vessel, -towards) - offset
    gap = min(_LIP_GAP, _LIP_GAP_SHARE * radius)
    T_pinch_in_thing = invert_pose(T_thing_in_pinch)
    angles, rows = list[float](), list[Array]()
    for angle in np.arange(0.0, _MAX_TILT + 1e-9, _TILT_STEP):
        height = max(T_vessel[2, 3] + rim + lip_height(angle, tall, behind, gap), table + gap + tall * math.cos(angle))
        at = T_vessel[:3, 3] - offset * towards
        at[2] = height
        turned = rotation_from_vector(angle * axis) @ R
        T_thing = pose(at - turned @ (lip * direction + [0.0, 0.0, tall]), turned)
        found = hand.solve_ik(T_thing @ T_pinch_in_thing, (rows[-1] if rows else source.joints,))
        if found is None or (rows and np.abs(found - rows[-1]).max() > _MAX_JOINT_STEP):
            break
        if context.find_contact(hand, found, source.opening, source.load):
            break
        angles.append(float(angle))
        rows.append(found)
    if not angles or angles[-1] < _MIN_TILT:
        return None
    narrow = radius < _NARROW
    longest = _NARROW_SHAKE if narrow else max(_SHAKES)
    back, stroke = _shake_back(context, source, rows[-1], longest)
    return PouringTilt(np.array(angles), np.array(rows), back, stroke, narrow)


def _edge_distance(context: PlanningContext, vessel: str, direction: Array) -> float:
    """Return the distance from a vessel's middle to the edge of its bounding box in a horizontal direction (3,), m."""
    half = np.abs(context.world.local_box(vessel)[:, :2]).max(axis=0)
    along = np.abs(context.world.pose(vessel)[:3, :3].T @ direction)[:2]
    return float((half / np.maximum(along, 1e-9)).min())


def lip_height(angle: float, tall: float, behind: float, gap: float) -> float:
    """Return the least height of a tilted source's lip over a vessel's rim, m, at which it keeps `gap` from it, m.

    Either the source's bottom is over the rim, or its lower side passes over the rim.

    Args:
        angle: of the tilt, rad.
        tall: height of the source, m.
        behind: horizontal distance from the lip back to the rim, m.
    """
    cos, sin = max(math.cos(angle), 0.0), math.sin(angle)
    if cos == 0.0:
        return gap
    return min(tall * cos + gap, (gap + behind * cos) / max(sin, 1e-9))


def _shake_back(context: PlanningContext, source: HeldSource, joints: Array, longest: float) -> tuple[Array, float]:
    """Return joints (dof,) that draw a tilted source back along its axis without a contact, and how far, m."""
    hand, T = source.hand, source.hand.pinch_pose(joints)
    axis = (T @ source.load.T_thing_in_pinch)[:3, 2]
    for stroke in (stroke for stroke in _SHAKES if stroke <= longest):
        found = hand.solve_ik(pose(T[:3, 3] - stroke * axis, T[:3, :3]), (joints,))
        if (
            found is not None
            and np.abs(found - joints).max() < _MAX_JOINT_STEP
            and not any(
                context.find_contact(hand, at, source.opening, source.load) for at in ((joints + found) / 2, found)
            )
        ):
            return found, stroke
    return joints, 0.0


def carry_upright(context: PlanningContext, hand: Hand, tilt: Tilt) -> Iterator[MotionSegment]:
    """Yield the motions that bring a held source upright over the vessel: up and across, or around what is between."""
    held = hand.held_object
    assert held is not None
    load = AttachedObject(held.thing, held.T_thing_in_pinch)

    def contact_or_tilt(joints: Array) -> str | None:
        upright = float((hand.pinch_pose(joints) @ held.T_thing_in_pinch)[2, 2])
        if upright < _UPRIGHT:
            return f"the tilt of the {held.thing}"
        return context.find_contact(hand, joints, hand.opening, load)

    T, T_over = hand.pinch_pose(hand.joints), hand.pinch_pose(tilt.joints[0])
    T_up = T.copy()
    T_up[2, 3] = max(T[2, 3], T_over[2, 3])
    try:
        yield context.make_segment({hand: context.plan_line(hand, T_up, _CARRY_SPEED)}, wait_for_arrival=False)
        path = context.plan_line(hand, T_over, _CARRY_SPEED)
        # A difference from the first joints of the tilt of at most `_SAME_JOINTS` is small enough to step over.
        direct = np.abs(path[-1] - tilt.joints[0]).max() < _SAME_JOINTS and is_collision_free(path, contact_or_tilt)
    except SkillFailedError:
        direct = False
    if not direct:
        rng = np.random.default_rng(_SEARCH_SEED)
        around = plan_free_path(hand, tilt.joints[0], contact_or_tilt, context.tick, rng)
        if around is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no free way for the {held.thing} to the vessel")
        path = around
    yield context.make_segment({hand: path})


def tilt_path(tilt: Tilt, start: float, end: float) -> Array:
    """Return a motion (n + 1, dof) from one angle to another, rad."""
    return np.array([tilt.joints_at(angle) for angle in np.linspace(start, end, TICKS + 1)])


def straight_tilt(tilt: Tilt, start: float, end: float) -> Array:
    """Return a motion (n + 1, dof) from one angle to another, rad, along a straight line of joints: one action.

    `tilt_path` bends where the tilt does, so that 30 degrees take two actions and 45 degrees two or three. Here the
    object's lip leaves its place between the ends.
    """
    return np.linspace(tilt.joints_at(start), tilt.joints_at(end), TICKS + 1)
