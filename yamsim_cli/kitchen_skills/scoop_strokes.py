"""Strokes of a spoon or a measuring cup through a dish of loose pieces: the poses of the tool, and an arm's joints.

A stroke has a heading in `world`, in which the tool moves and its tip or lip points. It goes down into the dish, along
its floor, and up again along the far wall.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import ContainerShape, CutleryShape, VesselShape
from ..core.expert.planning.collision_checker import AttachedObject
from ..core.expert.skills.grasp_candidates import GraspCandidate
from ..core.expert.skills.hand import Hand
from ..core.expert.skills.planning_context import PlanningContext
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_vector, rotation_z
from .tilting import HeldSource, Tilt, grasps_from_side, height_of, lip_height, opening_radius

_MAX_STEP = 1.5  # rad, of a joint between two poses of a stroke or of a way; more is another posture
_CHECKS = (0.5, 1.0)  # shares of the way between two poses at which contacts are checked

# Poses of a stroke: distance of the tip from the dish's far wall along the heading, m; its height over the dish's
# floor, m; and the tool's angle, degrees: the spoon's pitch, and the cup's tilt. With 82 degrees, the side of the cup
# lies on the floor, because its wall slopes by 8 degrees. With less, it stands on its foot, so that its rim rises over
# the pieces. The pieces turn the cup in the hand by some degrees within a motion. Its tilt along the floor is therefore
# 92 degrees or more, and its height down to 2 mm below it.
_SPOON_STROKE = (
    (-0.170, 0.080, -45), (-0.170, 0.004, -45), (-0.080, 0.002, -25), (-0.015, 0.004, -18), (-0.010, 0.030, 8),
    (-0.050, 0.130, 16),
)  # fmt: skip
_CUP_STROKE = (
    (-0.150, 0.060, 108), (-0.150, 0.001, 104), (-0.085, -0.001, 97), (-0.008, -0.002, 92), (-0.002, 0.014, 76),
    (-0.004, 0.045, 62), (-0.030, 0.130, 60),
)  # fmt: skip
_WALL_CLEARANCE = 0.004  # m, from a tool to the long walls of a dish: a cup that rubs on a wall rises over pieces
_SPOON_LEANS = tuple(math.radians(angle) for angle in (15, 30, -15, -30))  # rad, of the hand along the spoon
# Directions from which a hand may grasp a cup: pads lie flat on its collision boxes.
_CUP_AZIMUTHS = 8
# Heights of that hand, as shares of the cup's height. Near its rim, pieces turn it less in the hand.
_CUP_SHARES = (0.7, 0.6, 0.5)
# m, from the cup's axis back to the middles of the pads. When the cup lies on its side, the hand points down. This
# raises the fingertips over the long walls of the dish.
_CUP_GRASP_BACK = 0.005
_SPOON_FORCE = 18.0  # N of each finger, command for the handle; the drive gives 15 N at its width of 20 mm
_SPOON_CLEARANCE = 0.010  # m, additional opening of each finger before closing; no other value is recorded
# rad, from the heading of a stroke to the tool's heading over a vessel
_SPOON_TURNS = tuple(math.radians(turn) for turn in (0, -30, 30, -60, 60, -90, 90, 120, -120, 150, -150, 180))
_CUP_TURNS = tuple(math.radians(turn) for turn in range(-165, 181, 15))
_ROLLS = (0, 1, -1)  # the side to which a spoon rolls over a vessel; 0 for one that tilts down by its tip
_SPOON_ANGLES = tuple(math.radians(angle) for angle in range(0, 106, 15))  # rad, of a spoon's tilt: it begins level
# rad, of a cup's tilt: it begins near the 60 degrees with which a stroke ends
_CUP_ANGLES = tuple(math.radians(angle) for angle in range(65, 146, 10))
_SPOON_RELEASE = math.radians(60)  # rad, least largest tilt of a spoon: pieces slide from 19 degrees on (friction 0.35)
_SPOON_ENOUGH = math.radians(90)  # rad, tilt of a spoon beyond which more counts nothing: its head is vertical
# rad, least largest tilt of a cup: its wall slopes by 8 degrees, so pieces slide from 101 degrees on (friction 0.35)
_CUP_RELEASE = math.radians(105)
_CUP_ENOUGH = math.radians(125)  # rad, tilt of a cup beyond which more counts nothing; no other value is recorded
_ROLLS_LEFT = (0.0, 0.5, 1.0)  # shares of a spoon's roll in its hand that stay when it is laid down, in the order tried
# rad, turns about the vertical of a spoon that is laid down, in the order tried: its first heading suits another grasp
_LAYING_TURNS = tuple(math.radians(turn) for turn in (0, 20, -20, 40, -40))
_LAYING_OVER = 0.004  # m, of a spoon over its first place when the hand opens, so that it does not press on the table
_LAYING_RISE = 0.012  # m, by which a fully rolled spoon is higher than that; no other value is recorded
_LAYING_WAY = 0.06  # m, of the way straight down to that place; no other value is recorded
_WAY_COST = 0.3  # rad of tilt that a way longer by 1 rad has to gain: longer ways need more actions
# m, of a cup's lip behind the vessel's middle: about half of a piece (34 mm), which then topples, and nearer to the
# wall. The one with the better tilt is used.
_LIPS_BEHIND = (0.02, 0.045)
_LIP_GAP = 0.025  # m, from a cup to the vessel's rim; no other value is recorded
_TIP_BEHIND = 0.015  # m, of a spoon's tip behind the vessel's middle, so that pieces that slide off fall near it
_TIP_OVER = 0.03  # m, of a spoon's tip over the vessel's rim; no other value is recorded
_TIP_AHEAD = 0.025  # m, of the tip of a spoon that rolls, ahead of the vessel's middle: its head is then over it
_SIDE_OVER = 0.035  # m, of the tip of a spoon that rolls, over the vessel's rim: its side goes down by half its width
# m in the spoon's frame: the box over its head in which pieces count as carried
_HEAD_LOW: Array = np.array((-0.035, 0.02, -0.005))
_HEAD_HIGH: Array = np.array((0.035, 0.115, 0.08))


@dataclass(frozen=True)
class ScoopTool:
    """A spoon, or a cup whose mouth tilts towards `forward` (3,), a horizontal unit vector in its frame.

    Attributes:
        tip: the point (3,) in the tool's frame that goes first: a spoon's tip, or a point of a cup's rim, m.
        swath_half_width: of the swath of a stroke, m.
        tool_half_width: half of the tool's width, m.
    """

    is_spoon: bool
    forward: Array
    tip: Array
    swath_half_width: float
    tool_half_width: float

    def pose_at(self, tip: Array, heading: float, angle: float) -> Array:
        """Return the tool's pose (4, 4) with its tip at a point (3,) in `world`.

        `angle` is the pitch of a spoon, negative with its tip down, or the tilt of a cup, rad.
        """
        own = math.atan2(self.forward[1], self.forward[0])
        ahead = np.array((math.cos(heading), math.sin(heading), 0.0))
        turn = -angle if self.is_spoon else angle
        R = rotation_from_vector(turn * np.cross((0.0, 0.0, 1.0), ahead)) @ rotation_z(heading - own)
        return pose(tip - R @ self.tip, R)

    @property
    def _knots(self) -> tuple[tuple[float, float, float], ...]:
        return _SPOON_STROKE if self.is_spoon else _CUP_STROKE

    @property
    def entry(self) -> float:
        """Distance from the far wall at which the tool goes down, along the heading: negative, m."""
        return self._knots[0][0]

    def fits(self, dish: ObjectConfig, aside: float) -> bool:
        """Whether the tool moves along a dish `aside` m from its middle without touching its long walls."""
        room = _shape_of(dish).size_mm[0] / 2000 - _shape_of(dish).wall_mm / 1000
        return abs(aside) + self.tool_half_width + _WALL_CLEARANCE <= room

    def stroke(self, dish: ObjectConfig, T_dish: Array, heading: float, aside: float, before: float) -> list[Array]:
        """Return the tool's poses (4, 4) of a stroke along a dish that passes `aside` m to the left of its middle.

        The tool stays at least `before` m from the far wall.
        """
        wall = _shape_of(dish).wall_mm / 1000
        ahead = np.array((math.cos(heading), math.sin(heading), 0.0))
        left = np.array((-ahead[1], ahead[0], 0.0))
        end = T_dish[:3, 3] + half_length(dish) * ahead + aside * left + (0.0, 0.0, wall)
        return [
            self.pose_at(end + min(along, -before) * ahead + (0.0, 0.0, up), heading, math.radians(degrees))
            for along, up, degrees in self._knots
        ]


def _shape_of(dish: ObjectConfig) -> ContainerShape:
    assert isinstance(dish.shape, ContainerShape), "a dish is a container"
    return dish.shape


def half_length(dish: ObjectConfig) -> float:
    """Return the distance from a dish's middle to its far wall, m."""
    return _shape_of(dish).size_mm[1] / 2000 - _shape_of(dish).wall_mm / 1000


def stroke_heading(T_dish: Array) -> float:
    """Return the heading in `world` along a dish, rad: to its end at which the pieces lie at the start."""
    return math.atan2(-T_dish[1, 1], -T_dish[0, 1])


def tool_of(config: ObjectConfig, T_pinch_in_tool: Array) -> ScoopTool | None:
    """Return the tool in a grasp; None if it is neither a spoon nor a round vessel."""
    shape = config.shape
    if isinstance(shape, CutleryShape) and shape.kind == "spoon":
        width, length, _ = (size / 1000 for size in shape.size_mm)
        return ScoopTool(True, np.array((0.0, 1.0, 0.0)), np.array((0.0, length / 2, 0.008)), width / 2, width / 2)
    if isinstance(shape, VesselShape):
        forward = T_pinch_in_tool[:3, 2] * (1.0, 1.0, 0.0)
        forward /= np.linalg.norm(forward)
        radius = shape.diameter_mm / 2000
        return ScoopTool(False, forward, radius * forward + (0.0, 0.0, shape.height_mm / 1000), 0.8 * radius, radius)
    return None


def tool_grasps(config: ObjectConfig) -> Iterator[GraspCandidate]:
    """Yield grasps of a spoon by its handle, or of a cup from the side."""
    if isinstance(config.shape, CutleryShape):
        yield from _handle_grasps(config)
    else:
        for grasp in grasps_from_side(config, _CUP_AZIMUTHS, _CUP_SHARES):
            yield replace(grasp, T_pinch_in_thing=grasp.T_pinch_in_thing @ pose((0.0, 0.0, -_CUP_GRASP_BACK)))


def _handle_grasps(config: ObjectConfig) -> Iterator[GraspCandidate]:
    assert config.grasp is not None and config.grasp.friction is not None, "cutlery can be grasped"
    points = sorted(config.grasp.friction.points, key=lambda point: abs(point.position[1] - config.inertia.centre[1]))
    for point, lean, turned in itertools.product(points, _SPOON_LEANS, (False, True)):
        T = point.T_pinch_in_object(turned) @ pose(rotation=rotation_from_vector((0.0, lean, 0.0)))
        yield GraspCandidate(T, point.opening, _SPOON_CLEARANCE, _SPOON_FORCE)


def pieces_on_spoon(T_spoon: Array, centres: Array) -> NDArray[np.bool_]:
    """Return whether each piece, by its centre (n, 3) in `world`, is over the head of a spoon at a pose (4, 4)."""
    local: Array = (centres - T_spoon[:3, 3]) @ T_spoon[:3, :3]
    return np.asarray(np.all((local >= _HEAD_LOW) & (local <= _HEAD_HIGH), axis=1), dtype=np.bool_)


def plan_knots(
    context: PlanningContext, hand: Hand, opening: float, load: AttachedObject, poses: Sequence[Array], start: Array
) -> Array:
    """Return joints (n, dof) that bring a held tool to its poses (4, 4) one after another, as far as there is a way."""
    rows, T_pinch_in_tool = list[Array](), invert_pose(load.T_thing_in_pinch)
    for T_tool in poses:
        found = hand.solve_ik(T_tool @ T_pinch_in_tool, (rows[-1],) if rows else (start, hand.ready_joints))
        if found is None:
            break
        if rows and not is_free_step(context, hand, opening, load, rows[-1], found):
            break
        if not rows and context.find_contact(hand, found, opening, load):
            break
        rows.append(found)
    return np.array(rows)


def is_free_step(
    context: PlanningContext, hand: Hand, opening: float, load: AttachedObject, start: Array, end: Array
) -> bool:
    """Whether a hand can move a held tool straight from joints to others (dof,): without contact, in one posture."""
    if np.abs(end - start).max() > _MAX_STEP:
        return False
    return not any(context.find_contact(hand, start + share * (end - start), opening, load) for share in _CHECKS)


def plan_release(
    context: PlanningContext, source: HeldSource, tool: ScoopTool, vessel: str, heading: float
) -> Tilt | None:
    """Return the motion that tilts a held tool over the middle of a vessel; None if it is too short.

    A spoon tilts down by its tip, or to a side. A cup tilts further forward.
    """
    if tool.is_spoon:
        ways = (
            _spoon_release(context, tool, vessel, heading + turn, roll)
            for turn, roll in itertools.product(_SPOON_TURNS, _ROLLS)
        )
        return _best_tilt(context, source, ways, _SPOON_ANGLES, _SPOON_RELEASE, _SPOON_ENOUGH)
    ways = (
        _cup_release(context, source, tool, vessel, heading + turn, behind)
        for behind, turn in itertools.product(_LIPS_BEHIND, _CUP_TURNS)
    )
    return _best_tilt(context, source, ways, _CUP_ANGLES, _CUP_RELEASE, _CUP_ENOUGH)


def _best_tilt(
    context: PlanningContext,
    source: HeldSource,
    ways: Iterable[list[Array]],
    angles: tuple[float, ...],
    least: float,
    enough: float,
) -> Tilt | None:
    """Return the best tilt of a held tool that reaches the angle `least`, rad; None if no way does.

    Args:
        ways: poses (4, 4) of the tool at `angles`, rad, one list for each way.
        enough: angle, rad, beyond which more counts nothing.
    """
    best: tuple[float, Tilt] | None = None
    for poses in ways:
        rows = plan_knots(context, source.hand, source.opening, source.load, poses, source.joints)
        largest = angles[len(rows) - 1] if len(rows) else 0.0
        if largest < least:
            continue
        # A near start saves actions.
        score = min(largest, enough) - _WAY_COST * float(np.abs(rows[0] - source.joints).max())
        if best is None or score > best[0]:
            best = score, Tilt(np.array(angles[: len(rows)]), rows)
    return None if best is None else best[1]


def _spoon_release(context: PlanningContext, tool: ScoopTool, vessel: str, heading: float, roll: int) -> list[Array]:
    """Return the poses (4, 4) of a spoon that tilts over a vessel; `roll` is the side to which it rolls, or 0."""
    ahead = np.array((math.cos(heading), math.sin(heading), 0.0))
    tip = context.world.pose(vessel)[:3, 3] + (_TIP_AHEAD if roll else -_TIP_BEHIND) * ahead
    tip[2] += height_of(context.object_configs[vessel]) + (_SIDE_OVER if roll else _TIP_OVER)
    return [
        tool.pose_at(tip, heading, 0.0 if roll else -angle) @ _rolled(tool, roll * angle) for angle in _SPOON_ANGLES
    ]


def _cup_release(
    context: PlanningContext, source: HeldSource, tool: ScoopTool, vessel: str, heading: float, behind: float
) -> list[Array]:
    """Return the poses (4, 4) of a cup that tilts over a vessel, with its lip `behind` m behind the middle."""
    ahead = np.array((math.cos(heading), math.sin(heading), 0.0))
    config, T_vessel = context.object_configs[vessel], context.world.pose(vessel)
    tall, rim = height_of(context.object_configs[source.load.thing]), T_vessel[2, 3] + height_of(config)
    poses = []
    for angle in _CUP_ANGLES:
        lip = T_vessel[:3, 3] - behind * ahead
        lip[2] = rim + lip_height(angle, tall, opening_radius(config) - behind, _LIP_GAP)
        poses.append(tool.pose_at(lip, heading, angle))
    return poses


def plan_laying_down(
    context: PlanningContext, hand: Hand, load: AttachedObject, T_start: Array
) -> tuple[Array, Array] | None:
    """Return joints (dof,) over a held spoon's first place (4, 4) and at it; None if no way to lay it down is free."""
    T_held = hand.pinch_pose(hand.joints) @ load.T_thing_in_pinch
    upright = rotation_vector(T_start[:3, :3].T @ T_held[:3, :3])
    for share, turn in itertools.product(_ROLLS_LEFT, _LAYING_TURNS):
        T = T_start @ pose(rotation=rotation_z(turn) @ rotation_from_vector(share * upright * (0.0, 1.0, 0.0)))
        T[2, 3] += _LAYING_OVER + share * _LAYING_RISE
        T_over = T.copy()
        T_over[2, 3] += _LAYING_WAY
        rows = plan_knots(context, hand, hand.opening, load, (T_over, T), hand.joints)
        if len(rows) == 2:
            return rows[0], rows[1]
    return None


def _rolled(tool: ScoopTool, angle: float) -> Array:
    """Return the transform (4, 4) that rolls a spoon about the line along it through its tip."""
    return pose(tool.tip) @ pose(rotation=rotation_from_vector(angle * tool.forward)) @ pose(-tool.tip)
