"""Hand an object from one arm to the other: one picks it up and gives, the other takes it and places it.

The hands meet in the middle between the arms, both from above, the object level between them: each holds it at a
point of its own. The taking hand holds before the giving one lets go. Where friction holds, a hand stands still while
its fingers close, or open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..config.recording import GraspKind
from ..config.task import Exchange, TaskConfig
from ..config.things.thing import GraspPoint
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose, rotation_z, yaw
from ..types import Layout, Phases, Plan, Waypoint
from .plans import WELD_FINGERS_FROM, Hold, azimuth, leaning, raised
from .resting import resting_height


@dataclass(frozen=True)
class Schedule:
    """The control ticks by which things have happened; they do not depend on anything random.

    Attributes:
        near: the giving hand is over the object. Hands that hold by friction lean, so that their first way is longer.
        reached: it is at the object.
        grasped: it has it.
        met: it has brought it to the exchange.
        taken: the taking hand has it too.
        given: the giving hand has let go.
        placed: the taking hand lets go.
        total: of the attempt.
        grip: how long fingers take to close or to open where friction holds; 0 where the weld does.
    """

    near: int
    reached: int
    grasped: int
    met: int
    taken: int
    given: int
    placed: int
    total: int
    grip: int


def exchange(task: TaskConfig) -> Exchange:
    """The task's exchange."""
    assert task.exchange is not None  # checked when the config was loaded
    return task.exchange


def schedule(task: TaskConfig, grasp: GraspKind) -> Schedule:
    """When what happens."""
    way, meeting = task.timing.ticks_per_waypoint, exchange(task)
    grip = 0 if grasp == "weld" else task.timing.grip_ticks
    near = way if grasp == "weld" else 3 * way // 2
    reached = near + way
    grasped = reached + grip
    met = grasped + way + meeting.carry_ticks
    taken = met + meeting.take_ticks + grip
    given = taken + meeting.both_ticks
    # The taking hand waits until the giving one is on its way.
    placed = given + way // 2 + meeting.carry_ticks + way
    total = placed + grip + way + task.timing.settle_ticks
    return Schedule(near, reached, grasped, met, taken, given, placed, total, grip)


def start_opening(task: TaskConfig) -> float:
    """How far each finger of both arms is open at the start, m."""
    assert task.object.grasp is not None  # checked when the config was loaded
    return exchange(task).points[0].opening + task.object.grasp.clearance


def phases(task: TaskConfig, grasp: GraspKind, giver: int, taker: int) -> tuple[Phases, Phases]:
    """When the object is in the giving hand, and when in the taking one; both by their numbers in a compiled scene."""
    at = schedule(task, grasp)
    # Friction holds nothing any more once fingers begin to open; the weld does until they are.
    giving = Phases(at.reached, range(at.grasped, at.taken if at.grip else at.given), giver)
    return giving, Phases(at.reached, range(at.taken, at.placed), taker)


def exchange_pose(task: TaskConfig, layout: Layout, giving: GraspPoint, taking: GraspPoint, heading: float) -> Array:
    """The object's pose (4, 4) in `world` when it is handed over.

    Args:
        giving, taking: where the giving and the taking hand hold it.
        heading: of the way from the first to the second, in `world`, rad.
    """
    first, second = np.array(giving.position), np.array(taking.position)
    along = second - first
    R = rotation_z(heading - math.atan2(along[1], along[0]))
    place = exchange(task)
    height = layout.T_in_world[task.object.name][2, 3] + place.height
    x, y, _ = np.array((place.x, 0.0, 0.0)) - R @ ((first + second) / 2)
    return pose((x, y, height), R)


def wrist_turn(T_from: Array, T_to: Array, T_base_in_world: Array) -> float:
    """How far an object turns on its way, -pi..pi, not counting the turn of the arm that carries it about its base."""
    turned = yaw(T_to) - yaw(T_from) - azimuth(T_to, T_base_in_world) + azimuth(T_from, T_base_in_world)
    return math.remainder(turned, 2 * math.pi)


def _aside(task: TaskConfig, T_exchange: Array, heading: float) -> Array:
    """The exchange's pose (4, 4), moved aside along `heading` and up, where a hand is clear of the object."""
    T = raised(T_exchange, task.heights.approach)
    T[:2, 3] += exchange(task).clear * np.array((math.cos(heading), math.sin(heading)))
    return T


def _outwards(T_object: Array, T_base_in_world: Array) -> float:
    """Heading, in an object's own frame, of the direction away from an arm's base, rad."""
    return azimuth(T_object, T_base_in_world) + yaw(T_base_in_world) - yaw(T_object)


def _towards(hold: Hold, task: TaskConfig) -> float:
    """Heading, in the object's own frame, from where a hand holds it to where the other one does, rad.

    Hands that lean so have their wrists, and what hangs on them, away from each other.
    """
    other = next(point for point in exchange(task).points if point != hold.point)
    along = np.array(other.position) - np.array(hold.point.position)
    return math.atan2(along[1], along[0])


def giving_plan(
    task: TaskConfig,
    grasp: GraspKind,
    layout: Layout,
    T_base_in_world: Array,
    hold: Hold,
    T_exchange: Array,
    heading: float,
    phase: Phases,
) -> Plan:
    """The giving arm's: pick up, carry to the exchange, wait there until the object is taken, and go."""
    at, way, meeting = schedule(task, grasp), task.timing.ticks_per_waypoint, exchange(task)
    T_start = layout.T_in_world[task.object.name]
    to = _Fingers(task, grasp, hold)
    T_above, T_lifted = raised(T_start, task.heights.approach), raised(T_start, task.heights.lift)
    T_gone = _aside(task, T_exchange, heading + math.pi)
    waypoints: tuple[Waypoint, ...]
    if at.grip:
        waypoints = (
            to.open("pre-grasp", T_above, at.near),
            to.open("grasp", T_start, way),
            to.close("close", T_start, at.grip),
            to.close("lift", T_lifted, way, stop=False),
            to.close("exchange", T_exchange, meeting.carry_ticks),
            to.close("wait", T_exchange, meeting.take_ticks + at.grip),
            to.open("give", T_exchange, meeting.both_ticks),
            to.open("withdraw", T_gone, way),
        )
    else:
        giving = meeting.take_ticks + meeting.both_ticks
        waypoints = (
            to.open("pre-grasp", T_above, at.near),
            to.close("grasp", T_start, way),
            to.close("lift", T_lifted, way, stop=False),
            to.close("exchange", T_exchange, meeting.carry_ticks),
            to.open("give", T_exchange, giving, fingers_from=meeting.take_ticks / giving),
            to.open("withdraw", T_gone, way),
        )
    outwards = _outwards(T_start, T_base_in_world) if grasp == "weld" else _towards(hold, task)
    return _plan(task, grasp, waypoints, outwards, hold, phase, ("grasp", "give"), at.total)


def taking_plan(
    task: TaskConfig,
    grasp: GraspKind,
    layout: Layout,
    T_base_in_world: Array,
    hold: Hold,
    T_exchange: Array,
    heading: float,
    phase: Phases,
) -> Plan:
    """The taking arm's: come near, take the object, wait until it is given, carry it to the target, and put it down.

    On its way from the exchange, the object turns as far as the arm turns about its base.
    """
    at, way, meeting, heights = schedule(task, grasp), task.timing.ticks_per_waypoint, exchange(task), task.heights
    T_target = layout.T_in_world[task.target.name]
    turn = azimuth(T_target, T_base_in_world) - azimuth(T_exchange, T_base_in_world)
    T_goal = T_target.copy()
    T_goal[:3, :3] = rotation_z(yaw(T_exchange) + turn)
    T_goal[2, 3] += resting_height(task.object, task.target)
    T_arc = pose(
        [*(T_exchange[:2, 3] + T_goal[:2, 3]) / 2, max(T_exchange[2, 3], T_goal[2, 3] + heights.arc)],
        interpolate_rotation(T_exchange[:3, :3], T_goal[:3, :3], 0.5),
    )
    to = _Fingers(task, grasp, hold)
    half = meeting.carry_ticks // 2
    T_above, T_placed = raised(T_goal, heights.approach), raised(T_goal, heights.release)
    before = to.open("pre-take", _aside(task, T_exchange, heading), at.met)
    carried = (
        to.close("hold", T_exchange, meeting.both_ticks + way // 2),
        to.close("arc-top", T_arc, half, stop=False),
        to.close("pre-place", T_above, meeting.carry_ticks - half),
    )
    after = to.open("retract", T_above, way)
    waypoints: tuple[Waypoint, ...]
    if at.grip:
        taken = to.open("take", T_exchange, meeting.take_ticks), to.close("close", T_exchange, at.grip)
        put = to.close("place", T_placed, way), to.open("open", T_placed, at.grip)
        waypoints = (before, *taken, *carried, *put, after)
    else:
        waypoints = (
            before,
            to.close("take", T_exchange, meeting.take_ticks),
            *carried,
            to.open("place", T_placed, way),
            after,
        )
    outwards = _outwards(T_exchange, T_base_in_world) if grasp == "weld" else _towards(hold, task)
    return _plan(task, grasp, waypoints, outwards, hold, phase, ("take", "place"), at.total)


def _plan(
    task: TaskConfig,
    grasp: GraspKind,
    waypoints: tuple[Waypoint, ...],
    outwards: float,
    hold: Hold,
    phase: Phases,
    ends: tuple[str, str],
    total: int,
) -> Plan:
    """A plan of so many ticks in all; `ends` names where the hand takes the object and where it lets go."""
    names = [waypoint.name for waypoint in waypoints]
    return Plan(
        object=task.object.name,
        T_object_in_pinch=inverse(leaning(hold, outwards)),
        waypoints=waypoints,
        grasp=names.index(ends[0]),
        release=names.index(ends[1]),
        weld=grasp == "weld",
        phases=phase,
        settle_ticks=total - sum(waypoint.ticks for waypoint in waypoints),
    )


class _Fingers:
    """Makes waypoints with the fingers closed on the object, or open beside it."""

    def __init__(self, task: TaskConfig, grasp: GraspKind, hold: Hold) -> None:
        held = task.object.grasp
        assert held is not None  # checked when the config was loaded
        self._closed, self._opened = hold.point.opening, hold.point.opening + held.clearance
        self._force = held.friction.force if grasp == "contact" and held.friction else 0.0
        self._from = WELD_FINGERS_FROM if grasp == "weld" else 0.0

    def close(self, name: str, T: Array, ticks: int, *, stop: bool = True) -> Waypoint:
        return Waypoint(name, T, ticks, stop, self._closed, self._force, self._from)

    def open(self, name: str, T: Array, ticks: int, *, fingers_from: float | None = None) -> Waypoint:
        moving_from = self._from if fingers_from is None else fingers_from
        return Waypoint(name, T, ticks, True, self._opened, 0.0, moving_from)
