"""Pour the loose pieces in an object into a vessel."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.goals.world import TABLE
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import ContainerShape, VesselShape
from ..core.expert.planning.collision_checker import AttachedObject
from ..core.expert.skills.grasp_candidates import GraspCandidate
from ..core.expert.skills.hand import Hand
from ..core.expert.skills.pick import Pick, ReachableGrasp
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import Skill, find_holding_hand
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector

_FORCE = 25.0  # N, of each finger: holds a carton with 500 g by friction, with a margin of ten
_CLEARANCE = 0.006  # m, additional opening of each finger before closing: a carton is 80 mm wide, a hand opens 95 mm
_GRASP_AZIMUTHS = 24  # directions from which a hand may grasp a round source
_GRASP_TILTS = (8, 0, 20, 30, 40)  # degrees down from horizontal, of that hand, in the order tried
_GRASP_SHARES = (0.6, 0.5, 0.7, 0.4)  # heights of that hand, as shares of the source's height
_LIFT = 0.05  # m
_RISE, _MAX_RISES = 0.04, 6  # m and count, of the steps in which a hand rises from a source that it touches

_TILT_AZIMUTHS = 16  # directions in which a round source may tilt
_TILT_STEP = math.radians(5)  # rad, between the angles of a tilt at which contacts are checked
_MAX_TILT = math.radians(145)  # rad; a source that tilts further is empty already
_MIN_TILT = math.radians(95)  # rad, least tilt that a grasp has to allow
_ENOUGH_TILT = math.radians(135)  # rad; no other grasp is tried once one allows that
_MAX_JOINT_STEP = 0.6  # rad, of a joint in one step of a tilt; more is another posture
_LIP_GAP = 0.02  # m, from the vessel's rim up to the source
_LIP_OFFSET = 0.35  # of the vessel's radius, by which the lip stays behind the middle: pieces fly on

_TICKS = 10  # control ticks of a step: one action of the benchmark
_FAST_STEP, _SLOW_STEP = math.radians(12), math.radians(4)  # rad, of a step before and after the first piece left
_SLOW_SHARE = 0.05  # of the pieces; if more leave in a step, the source tilts no further
_SHAKE = math.radians(10)  # rad, back and forth, of a source that tilts no further: friction holds pieces in it
_MAX_WAITS = 6  # steps without a piece that leaves, at the largest tilt
_CARRY_SPEED = 0.25  # m/s


@dataclass(frozen=True)
class _Tilt:
    """A motion that tilts the source over the vessel, as its angles (n,), rad, increasing from 0, and joints (n, dof)."""

    angles: Array
    joints: Array

    def joints_at(self, angle: float) -> Array:
        return np.array([np.interp(angle, self.angles, row) for row in self.joints.T])


class Pour(Skill):
    """Pour the loose pieces in `thing` into another object until the share `share` of them has left.

    A hand grasps the source from the side, carries it over the vessel, and tilts it by steps. It tilts slowly once
    pieces leave, and waits while pieces leave or fall. Then it tilts the source back, and keeps it in the hand.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into")
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    thing: str
    into: str
    share: Annotated[FiniteFloat, Field(gt=0, le=1)] = 1.0

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if enough has left already; see `Skill.run`."""
        thing, vessel = roles.object_of(self.thing), roles.object_of(self.into)
        pieces = _Pieces(context, thing, vessel)
        if pieces.left_share >= self.share:
            return
        hand = find_holding_hand(context, thing)
        if hand is None:
            yield from _raise_touching_hands(context)
            hand, grasp = self._find_grasp(context, thing, vessel)
            yield from Pick(thing=self.thing, lift=_LIFT).grasp_and_lift(context, hand, thing, grasp)
        held = context.measure_held_object(hand)
        tilt = _longest_tilt(context, hand, thing, vessel, held.T_thing_in_pinch, hand.joints)
        if tilt is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no way to tilt the {thing} over the {vessel}")
        yield from _carry(context, hand, tilt)
        yield from self._tilt_until_poured(context, hand, tilt, pieces)


    def _find_grasp(self, context: PlanningContext, thing: str, vessel: str) -> tuple[Hand, ReachableGrasp]:
        """Return the hand and the grasp with which the source tilts furthest."""
        best: tuple[float, Hand, ReachableGrasp] | None = None
        picker, reasons = Pick(thing=self.thing, lift=_LIFT), dict[str, int]()
        hands = sorted(
            context.free_hands("any"),
            key=lambda hand: float(
                np.linalg.norm(context.world.pose(thing)[:2, 3] - hand.arm.T_base_in_world[:2, 3])
            ),
        )
        for hand, candidate in itertools.product(hands, list(_grasps(context.object_configs[thing]))):
            found = picker.find_reachable_grasp(context, hand, thing, candidate)
            if not isinstance(found, ReachableGrasp):
                if found is not None:
                    reasons[found] = reasons.get(found, 0) + 1
                continue
            tilt = _longest_tilt(
                context, hand, thing, vessel, invert_pose(candidate.T_pinch_in_thing), found.grasp_joints
            )
            if tilt is not None and (best is None or tilt.angles[-1] > best[0]):
                best = (float(tilt.angles[-1]), hand, found)
                if best[0] >= _ENOUGH_TILT:
                    break
        if best is None:
            summary = "; ".join(f"{why} ({n})" for why, n in sorted(reasons.items(), key=lambda item: -item[1])[:3])
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no grasp to pour from the {thing}: {summary}")
        return best[1], best[2]

    def _tilt_until_poured(
        self, context: PlanningContext, hand: Hand, tilt: _Tilt, pieces: _Pieces
    ) -> Iterator[MotionSegment]:
        angle, left, waits = 0.0, pieces.left_share, 0
        largest = float(tilt.angles[-1])
        while pieces.left_share < self.share and waits < _MAX_WAITS:
            before, left = left, pieces.left_share
            waits = waits + 1 if angle == largest and left == before else 0
            if left > before + _SLOW_SHARE:
                # Enough pieces leave already.
                goal = angle
            else:
                goal = min(angle + (_FAST_STEP if left == 0 else _SLOW_STEP), largest)
            if goal == angle:
                back = max(goal - _SHAKE, 0.0)
                yield context.make_segment({hand: _tilt_path(tilt, angle, back)}, wait_for_arrival=False)
                yield context.make_segment({hand: _tilt_path(tilt, back, angle)}, wait_for_arrival=False)
            else:
                yield context.make_segment({hand: _tilt_path(tilt, angle, goal)}, wait_for_arrival=False)
            angle = goal
        while angle > 0:
            goal = max(0.0, angle - 2 * _FAST_STEP)
            yield context.make_segment({hand: _tilt_path(tilt, angle, goal)}, wait_for_arrival=False)
            angle = goal


class _Pieces:
    """The loose pieces of a filled object, and where they are now."""

    def __init__(self, context: PlanningContext, thing: str, vessel: str) -> None:
        model = context.model
        self._world, self._thing, self._vessel = context.world, thing, vessel
        self._bodies = [k for k in range(model.nbody) if model.body(k).name.startswith(f"{thing}_piece_")]

    @property
    def left_share(self) -> float:
        """Share of the pieces that are not in the source any more."""
        return 1.0 - self._share_in(self._thing)

    @property
    def arrived_share(self) -> float:
        """Share of the pieces that are in the vessel."""
        return self._share_in(self._vessel)

    def _share_in(self, container: str) -> float:
        points = self._world.data.xipos[self._bodies]
        return float(self._world.points_inside(container, points).mean())


def _raise_touching_hands(context: PlanningContext) -> Iterator[MotionSegment]:
    """Raise hands that touch something at the start, such as a tall source, until they are free, and wait."""
    for hand in context.free_hands("any"):
        T = hand.pinch_pose(hand.joints)
        for _ in range(_MAX_RISES):
            if context.find_contact(hand, hand.joints, hand.opening) is None:
                break
            T[2, 3] += _RISE
            yield context.make_segment({hand: context.plan_line(hand, T)})


def _grasps(source: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield grasps of a source from the side, for hands that point horizontally or somewhat down."""
    shape = source.shape
    for share, tilt in itertools.product(_GRASP_SHARES, _GRASP_TILTS):
        down = math.radians(tilt)
        if isinstance(shape, VesselShape):
            height, count = share * shape.height_mm / 1000, _GRASP_AZIMUTHS
            widths = [shape.diameter_mm / 1000] * count
        elif isinstance(shape, ContainerShape):
            height, count = share * shape.size_mm[2] / 1000, 4
            widths = [shape.size_mm[1 - k % 2] / 1000 for k in range(count)]
        else:
            return
        for k, width in enumerate(widths):
            turn = 2 * math.pi * k / count
            x, y = math.cos(turn), math.sin(turn)
            forward = np.array([x * math.cos(down), y * math.cos(down), -math.sin(down)])
            for side in (1.0, -1.0):
                closing = side * np.array([-y, x, 0.0])
                R = np.column_stack([np.cross(closing, forward), closing, forward])
                yield GraspCandidate(pose((0.0, 0.0, height), R), width / 2, _CLEARANCE, _FORCE)


def _tilt_directions(source: ObjectConfig, T_source: Array) -> Iterator[tuple[Array, float]]:
    """Yield horizontal unit vectors (3,) in the source's frame towards which it may tilt, and the lip's distance, m."""
    shape = source.shape
    if isinstance(shape, ContainerShape):
        for k, side in itertools.product((0, 1), (1.0, -1.0)):
            yield side * np.eye(3)[k], shape.size_mm[k] / 2000
        return
    assert isinstance(shape, VesselShape)
    for k in range(_TILT_AZIMUTHS):
        turn = 2 * math.pi * k / _TILT_AZIMUTHS
        yield np.array([math.cos(turn), math.sin(turn), 0.0]), shape.diameter_mm / 2000


def _longest_tilt(
    context: PlanningContext, hand: Hand, thing: str, vessel: str, T_thing_in_pinch: Array, joints: Array
) -> _Tilt | None:
    """Return the motion that tilts a held source furthest over a vessel; None if none reaches `_MIN_TILT`."""
    best: _Tilt | None = None
    T_held = hand.pinch_pose(joints) @ T_thing_in_pinch
    for direction, lip in _tilt_directions(context.object_configs[thing], T_held):
        found = _tilt_towards(context, hand, thing, vessel, T_thing_in_pinch, joints, direction, lip)
        if found is not None and (best is None or found.angles[-1] > best.angles[-1] + 1e-6):
            best = found
    return best


def _tilt_towards(
    context: PlanningContext,
    hand: Hand,
    thing: str,
    vessel: str,
    T_thing_in_pinch: Array,
    joints: Array,
    direction: Array,
    lip: float,
) -> _Tilt | None:
    source, target = context.object_configs[thing], context.object_configs[vessel]
    assert source.shape is not None and isinstance(target.shape, VesselShape)
    tall = float(source.shape.size_mm[2] if isinstance(source.shape, ContainerShape) else source.shape.height_mm) / 1000
    radius, rim = target.shape.diameter_mm / 2000, target.shape.height_mm / 1000
    T_vessel, table = context.world.pose(vessel), float(context.world.aabb(TABLE)[1][2])
    R = (hand.pinch_pose(joints) @ T_thing_in_pinch)[:3, :3]
    towards = R @ direction
    towards[2] = 0.0
    towards /= np.linalg.norm(towards)
    axis = np.cross([0.0, 0.0, 1.0], towards)
    behind = _edge_distance(context, vessel, -towards) - _LIP_OFFSET * radius
    load = AttachedObject(thing, T_thing_in_pinch)
    T_pinch_in_thing = invert_pose(T_thing_in_pinch)
    angles, rows = [], []
    for angle in np.arange(0.0, _MAX_TILT + 1e-9, _TILT_STEP):
        height = max(
            T_vessel[2, 3] + rim + _lip_height(angle, tall, behind), table + _LIP_GAP + tall * math.cos(angle)
        )
        at = T_vessel[:3, 3] - _LIP_OFFSET * radius * towards
        at[2] = height
        turned = rotation_from_vector(angle * axis) @ R
        T_thing = pose(at - turned @ (lip * direction + [0.0, 0.0, tall]), turned)
        found = hand.solve_ik(T_thing @ T_pinch_in_thing, (rows[-1] if rows else joints,))
        if found is None or (rows and np.abs(found - rows[-1]).max() > _MAX_JOINT_STEP):
            break
        if context.find_contact(hand, found, hand.opening, load):
            break
        angles.append(angle)
        rows.append(found)
    if not angles or angles[-1] < _MIN_TILT:
        return None
    return _Tilt(np.array(angles), np.array(rows))


def _edge_distance(context: PlanningContext, vessel: str, direction: Array) -> float:
    """Return the distance from a vessel's middle to its edge in a horizontal direction (3,), m, with its handles."""
    shape = context.object_configs[vessel].shape
    assert isinstance(shape, VesselShape)
    if not shape.handles:
        return shape.diameter_mm / 2000
    half = np.abs(context.world.local_box(vessel)[:, :2]).max(axis=0)
    along = np.abs(context.world.pose(vessel)[:3, :3].T @ direction)[:2]
    return float((half / np.maximum(along, 1e-9)).min())


def _lip_height(angle: float, tall: float, behind: float) -> float:
    """Return the least height of a tilted source's lip over a vessel's rim, m, at which it keeps `_LIP_GAP` from it.

    Either the source's bottom is over the rim, or its lower side passes over the rim.

    Args:
        angle: of the tilt, rad.
        tall: height of the source, m.
        behind: horizontal distance from the lip back to the rim, m.
    """
    cos, sin = max(math.cos(angle), 0.0), math.sin(angle)
    if cos == 0.0:
        return _LIP_GAP
    return min(tall * cos + _LIP_GAP, (_LIP_GAP + behind * cos) / max(sin, 1e-9))


def _carry(context: PlanningContext, hand: Hand, tilt: _Tilt) -> Iterator[MotionSegment]:
    """Yield the motions that bring a held source upright over the vessel: up, and across."""
    T, T_over = hand.pinch_pose(hand.joints), hand.pinch_pose(tilt.joints[0])
    T_up = T.copy()
    T_up[2, 3] = max(T[2, 3], T_over[2, 3])
    yield context.make_segment({hand: context.plan_line(hand, T_up, _CARRY_SPEED)}, wait_for_arrival=False)
    yield context.make_segment({hand: context.plan_line(hand, T_over, _CARRY_SPEED)})


def _tilt_path(tilt: _Tilt, start: float, end: float) -> Array:
    """Return a motion (n + 1, dof) from one angle to another, rad."""
    return np.array([tilt.joints_at(angle) for angle in np.linspace(start, end, _TICKS + 1)])
