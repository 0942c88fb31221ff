"""Pour the loose pieces in an object into a vessel."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.goals.world import TABLE
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import ContainerShape, VesselShape
from ..core.expert.planning.collision_checker import AttachedObject
from ..core.expert.planning.trajectory import is_collision_free
from ..core.expert.skills.grasp_candidates import GraspCandidate
from ..core.expert.skills.hand import Hand
from ..core.expert.skills.pick import Pick, ReachableGrasp, summarize_reasons
from ..core.expert.skills.planning_context import (
    MotionSegment,
    PlanningContext,
    SkillFailedError,
    plan_free_path,
)
from ..core.expert.skills.skill import Skill, find_holding_hand
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_z
from ..loose_pieces import piece_name_prefix

_FORCE = 40.0  # N, of each finger; a carton with 500 g of pasta weighs 5.2 N, and swings between the pads
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
# rad, score of a tilt after which no other grasp is tried. With 145 degrees, a grasp that tilts by 130 was taken, and
# threw pieces beside a bowl. Over a narrow vessel, shakes are short, so that no tilt has this score.
_ENOUGH_TILT = math.radians(150)
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

_TICKS = 10  # control ticks of a step: one action of the benchmark
_FAST_STEP, _SLOW_STEP = math.radians(12), math.radians(4)  # rad, of a step before and after the first piece left
# Share of the pieces that may leave in a step over a narrow vessel. If more leave, the source tilts back.
_MAX_FLOW = 0.05
_BACK_STEP = math.radians(1)  # rad, by which it tilts back in a step
# m, strokes of a shake along the source's axis, in the order tried. At the largest tilt, friction holds pieces, and a
# shake of two actions loosens them.
_SHAKES = (0.16, 0.14, 0.12, 0.10, 0.08, 0.06, 0.04, 0.02)
# m, radius of a narrow vessel, and the stroke over it: longer ones throw pieces beside it
_NARROW, _NARROW_SHAKE = 0.06, 0.04
# Every third try that moves no piece is a swing instead of a shake; rad, of each of its two steps back.
_TRIES_PER_SWING, _SWING_STEP = 3, math.radians(30)
_MAX_TRIES = 20  # shakes and swings in a row that move no piece out, after which the expert gives up
_CARRY_SPEED = 0.25  # m/s
_UPRIGHT = math.cos(math.radians(25))  # least cosine of the tilt of a source on its way
_SAME_JOINTS = 0.05  # rad, between joints that count as the same posture
_SEARCH_SEED = 0  # of the random search for a way around


@dataclass(frozen=True)
class _Tilt:
    """A motion that tilts the source over the vessel, as its angles (n,), rad, increasing from 0, and joints (n, dof).

    `back` are joints (dof,) with which the source, at its largest angle, is drawn back along its axis by `stroke`, m.
    """

    angles: Array
    joints: Array
    back: Array
    stroke: float
    over_narrow_vessel: bool

    @property
    def score(self) -> float:
        """The largest angle, rad, and what the stroke of shaking is worth."""
        return float(self.angles[-1]) + _STROKE_VALUE * self.stroke

    def joints_at(self, angle: float) -> Array:
        """Return the joints (dof,) at an angle, rad."""
        return np.array([np.interp(angle, self.angles, row) for row in self.joints.T])


@dataclass(frozen=True)
class _HeldSource:
    """A source that a hand holds upright, now or in a grasp that is tried.

    Attributes:
        load: the source in the hand.
        joints: of the hand (dof,), rad.
        opening: of each finger, m.
        piece_length: of its loose pieces, m.
    """

    hand: Hand
    load: AttachedObject
    joints: Array
    opening: float
    piece_length: float


class Pour(Skill):
    """Pour the loose pieces in `thing` into another object until all of them have left.

    A hand grasps the source from the side, carries it over the vessel, and tilts it by steps, slowly once pieces leave.
    Over a narrow vessel, it tilts back a little while many pieces leave. At its largest tilt, it shakes the source
    along its axis. Then it tilts the source back, and keeps it in the hand.

    The skill counts the pieces in the source, so a piece that still falls counts as poured. It cannot pour a part of
    the content: pieces slide out together, up to three quarters of them in one action.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into")
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    thing: str
    into: str

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if the source is empty already; see `Skill.run`."""
        thing, vessel = roles.object_of(self.thing), roles.object_of(self.into)
        _require_shapes(context, thing, vessel)
        pieces = _Pieces(context, thing)
        if pieces.left_share == 1.0:
            return
        configs = context.object_configs
        try:
            yield from self._pour(context, thing, vessel, pieces)
        finally:
            # `_Pieces.weigh` has changed them.
            context.object_configs = configs

    def _pour(self, context: PlanningContext, thing: str, vessel: str, pieces: _Pieces) -> Iterator[MotionSegment]:
        hand = find_holding_hand(context, thing)
        if hand is None:
            yield from _raise_touching_hands(context)
            pieces.weigh()
            hand, grasp = self._find_grasp(context, thing, vessel, pieces.length)
            yield from Pick(thing=self.thing, lift=_LIFT).grasp_and_lift(context, hand, thing, grasp)
        load = AttachedObject(thing, context.measure_held_object(hand).T_thing_in_pinch)
        tilt = _longest_tilt(context, _HeldSource(hand, load, hand.joints, hand.opening, pieces.length), vessel)
        if tilt is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no way to tilt the {thing} over the {vessel}")
        yield from _carry(context, hand, tilt)
        yield from self._tilt_until_poured(context, hand, tilt, pieces)

    def _find_grasp(
        self, context: PlanningContext, thing: str, vessel: str, piece_length: float
    ) -> tuple[Hand, ReachableGrasp]:
        """Return the hand and the grasp with which the source tilts furthest."""
        best: tuple[float, Hand, ReachableGrasp] | None = None
        picker, reasons = Pick(thing=self.thing, lift=_LIFT), dict[str, int]()
        hands = sorted(
            context.free_hands("any"),
            key=lambda hand: float(np.linalg.norm(context.world.pose(thing)[:2, 3] - hand.arm.T_base_in_world[:2, 3])),
        )
        for hand, candidate in itertools.product(hands, list(_grasps(context.object_configs[thing]))):
            found = picker.find_reachable_grasp(context, hand, thing, candidate)
            if not isinstance(found, ReachableGrasp):
                if found is not None:
                    reasons[found] = reasons.get(found, 0) + 1
                continue
            load = AttachedObject(thing, invert_pose(candidate.T_pinch_in_thing))
            source = _HeldSource(hand, load, found.grasp_joints, candidate.opening, piece_length)
            tilt = _longest_tilt(context, source, vessel)
            if tilt is None:
                why = f"the {hand.side} arm cannot tilt it over the {vessel} with this grasp"
                reasons[why] = reasons.get(why, 0) + 1
            elif best is None or tilt.score > best[0]:
                best = (tilt.score, hand, found)
                if best[0] >= _ENOUGH_TILT:
                    break
        if best is None:
            why = summarize_reasons(reasons) or "no hand is free"
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no grasp to pour from the {thing}: {why}")
        return best[1], best[2]

    def _tilt_until_poured(
        self, context: PlanningContext, hand: Hand, tilt: _Tilt, pieces: _Pieces
    ) -> Iterator[MotionSegment]:
        """Yield the motions that tilt the source until it is empty, shake it at the largest angle, and tilt it back.

        Raise SkillFailedError if pieces stay in it, or if it falls out of the hand.
        """
        angle, left, most, tries = 0.0, pieces.left_share, 0.0, 0
        largest = float(tilt.angles[-1])
        while left < 1.0 and tries < _MAX_TRIES:
            pieces.weigh()
            goal = min(angle + (_FAST_STEP if left == 0 else _SLOW_STEP), largest)
            if tilt.over_narrow_vessel and left > most + _MAX_FLOW:
                # A little back, so that the flow ends.
                goal = max(angle - _BACK_STEP, 0.0)
            most = max(most, left)
            if angle < largest or goal < largest:
                yield context.make_segment({hand: _tilt_path(tilt, angle, goal)}, wait_for_arrival=False)
            else:
                is_swing = tries % _TRIES_PER_SWING == _TRIES_PER_SWING - 1 and not tilt.over_narrow_vessel
                for path in _swing(tilt) if is_swing else _shake(tilt):
                    yield context.make_segment({hand: path}, wait_for_arrival=False)
            angle, left = goal, pieces.left_share
            # A piece that goes in and out of the mouth counts once.
            tries = tries + 1 if left <= most and angle == largest else 0
        context.measure_held_object(hand)
        while angle > 0:
            pieces.weigh()
            goal = max(0.0, angle - 2 * _FAST_STEP)
            yield context.make_segment({hand: _tilt_path(tilt, angle, goal)}, wait_for_arrival=False)
            angle = goal
        if tries == _MAX_TRIES:
            raise SkillFailedError(
                FailureCause.GOAL,
                f"only {most:.0%} of the pieces left the source: {_MAX_TRIES} shakes in a row moved none",
            )


def _require_shapes(context: PlanningContext, thing: str, vessel: str) -> None:
    """Raise SkillFailedError unless the source is round or a container, and the vessel is round."""
    for name, shapes, use in (
        (thing, (VesselShape, ContainerShape), "poured from"),
        (vessel, (VesselShape,), "poured into"),
    ):
        if not isinstance(context.object_configs[name].shape, shapes):
            raise SkillFailedError(FailureCause.UNREACHABLE, f"the {name} has no shape that can be {use}")


class _Pieces:
    """The loose pieces of a filled object, and how many of them are in it now.

    Attributes:
        length: of a piece, m.
    """

    def __init__(self, context: PlanningContext, thing: str) -> None:
        self._context, self._world, self._thing = context, context.world, thing
        self._empty = context.object_configs[thing]
        model, prefix = context.model, piece_name_prefix(thing)
        self._bodies = np.array([k for k in range(model.nbody) if model.body(k).name.startswith(prefix)], dtype=int)
        if not len(self._bodies):
            raise SkillFailedError(FailureCause.UNREACHABLE, f"the {thing} has no loose pieces to pour")
        self.length = 2 * float(model.geom_size[model.body_geomadr[self._bodies[0]]][:2].sum())

    def weigh(self) -> None:
        """Let the planning context know the mass and the centre of mass of the source with the pieces in it now."""
        data, model = self._world.data, self._context.model
        T = self._world.pose(self._thing)
        bodies = self._bodies[self._are_inside()]
        masses = model.body_mass[bodies]
        centres = (data.xipos[bodies] - T[:3, 3]) @ T[:3, :3]
        empty = self._empty.inertia
        total = empty.mass + float(masses.sum())
        centre = (empty.mass * np.array(empty.centre) + masses @ centres) / total
        inertia = empty.model_copy(update={"mass_g": 1000 * total, "centre": tuple(float(x) for x in centre)})
        filled = self._empty.model_copy(update={"inertia": inertia})
        self._context.object_configs = {**self._context.object_configs, self._thing: filled}

    @property
    def left_share(self) -> float:
        """Share of the pieces that are not in the source any more."""
        return 1.0 - float(self._are_inside().mean())

    def _are_inside(self) -> NDArray[np.bool_]:
        return self._world.points_inside(self._thing, self._world.data.xipos[self._bodies])


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
            count = _GRASP_AZIMUTHS
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
                yield GraspCandidate(pose((0.0, 0.0, share * _height(source)), R), width / 2, _CLEARANCE, _FORCE)


def _height(source: ObjectConfig) -> float:
    """Return a source's height, m."""
    if isinstance(source.shape, ContainerShape):
        return source.shape.size_mm[2] / 1000
    assert isinstance(source.shape, VesselShape), "vessels and containers are poured from"
    return source.shape.height_mm / 1000


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


def _longest_tilt(context: PlanningContext, source: _HeldSource, vessel: str) -> _Tilt | None:
    """Return the motion that tilts a held source furthest over a vessel; None if none reaches `_MIN_TILT`."""
    best: _Tilt | None = None
    for direction, lip, turn in _tilt_directions(context.object_configs[source.load.thing]):
        found = _tilt_towards(context, source, vessel, direction, lip, turn)
        if found is not None and (best is None or found.score > best.score):
            best = found
    return best


def _tilt_towards(
    context: PlanningContext, source: _HeldSource, vessel: str, direction: Array, lip: float, turn: float
) -> _Tilt | None:
    """Return the motion that tilts a held source over a vessel as far as possible; None if that is not far enough.

    `direction`, `lip` and `turn` are as in `_tilt_directions`.
    """
    hand, T_thing_in_pinch = source.hand, source.load.T_thing_in_pinch
    target = context.object_configs[vessel]
    assert isinstance(target.shape, VesselShape), "only vessels are poured into"
    tall = _height(context.object_configs[source.load.thing])
    radius, rim = target.shape.diameter_mm / 2000, target.shape.height_mm / 1000
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
    return _Tilt(np.array(angles), np.array(rows), back, stroke, narrow)


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


def _shake_back(context: PlanningContext, source: _HeldSource, joints: Array, longest: float) -> tuple[Array, float]:
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


def _carry(context: PlanningContext, hand: Hand, tilt: _Tilt) -> Iterator[MotionSegment]:
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


def _shake(tilt: _Tilt) -> Iterator[Array]:
    """Yield the motions (n + 1, dof) of a shake along the source's axis, at the largest tilt."""
    yield np.linspace(tilt.joints[-1], tilt.back, _TICKS + 1)
    yield np.linspace(tilt.back, tilt.joints[-1], _TICKS + 1)


def _swing(tilt: _Tilt) -> Iterator[Array]:
    """Yield the motions (n + 1, dof) that tilt a source back and again, which loosens pieces that wedge each other."""
    largest = float(tilt.angles[-1])
    for start, end in ((0.0, 1.0), (1.0, 2.0), (2.0, 1.0), (1.0, 0.0)):
        yield _tilt_path(tilt, largest - start * _SWING_STEP, largest - end * _SWING_STEP)


def _tilt_path(tilt: _Tilt, start: float, end: float) -> Array:
    """Return a motion (n + 1, dof) from one angle to another, rad."""
    return np.array([tilt.joints_at(angle) for angle in np.linspace(start, end, _TICKS + 1)])
