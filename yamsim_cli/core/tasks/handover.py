"""Hand an object from one arm to the other: the right one picks it up and gives, the left one takes it and places it.

The hands meet in the middle between the arms, both from above, the object level between them: each holds it at a
point of its own. The taking hand holds before the giving one lets go.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..config.task import Exchange, TaskConfig
from ..config.things import GraspPoint
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose, rotation_z, yaw
from ..types import Layout, Phases, Plan, Waypoint
from .plans import WELD_FINGERS_FROM, Hold, azimuth, leaning, raised

# By their numbers in a compiled scene.
LEFT, RIGHT = 0, 1


@dataclass(frozen=True)
class Schedule:
    """Control ticks at which things happen, which nothing random changes.

    Attributes:
        grasped: the right hand has the object.
        met: it has brought it to the exchange.
        taken: the left hand has it too.
        given: the right hand has let go.
        placed: the left hand lets go.
        total: of the attempt.
    """

    grasped: int
    met: int
    taken: int
    given: int
    placed: int
    total: int


def exchange(task: TaskConfig) -> Exchange:
    """The task's exchange."""
    assert task.exchange is not None  # checked when the config was loaded
    return task.exchange


def schedule(task: TaskConfig) -> Schedule:
    """When what happens."""
    way, meeting = task.timing.ticks_per_waypoint, exchange(task)
    met = 3 * way + meeting.carry_ticks
    taken = met + meeting.take_ticks
    given = taken + meeting.both_ticks
    # The left hand waits until the right one is on its way.
    placed = given + way // 2 + meeting.carry_ticks + way
    return Schedule(2 * way, met, taken, given, placed, placed + way + task.timing.settle_ticks)


def phases(task: TaskConfig) -> tuple[Phases, Phases]:
    """When the object is in the right hand, and when in the left one."""
    at = schedule(task)
    right = Phases(at.grasped, range(at.grasped, at.given), RIGHT)
    return right, Phases(at.grasped, range(at.taken, at.placed), LEFT)


def exchange_pose(task: TaskConfig, layout: Layout, giving: GraspPoint, taking: GraspPoint, heading: float) -> Array:
    """Where the object (4, 4) is handed over, in `world`.

    Args:
        giving, taking: where the right and the left hand hold it.
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
    """By how much an object turns on its way, beyond what an arm that carries it turns about its base; -pi..pi."""
    turned = yaw(T_to) - yaw(T_from) - azimuth(T_to, T_base_in_world) + azimuth(T_from, T_base_in_world)
    return math.remainder(turned, 2 * math.pi)


def _aside(task: TaskConfig, T_exchange: Array, heading: float) -> Array:
    """The exchange as seen by a hand that is clear of the object: beside it along `heading`, and higher."""
    T = raised(T_exchange, task.heights.approach)
    T[:2, 3] += exchange(task).clear * np.array((math.cos(heading), math.sin(heading)))
    return T


def _outwards(T_object: Array, T_base_in_world: Array) -> float:
    """Heading, in an object's own frame, of what leads away from an arm's base, rad."""
    return azimuth(T_object, T_base_in_world) + yaw(T_base_in_world) - yaw(T_object)


def giving_plan(
    task: TaskConfig, layout: Layout, T_base_in_world: Array, hold: Hold, T_exchange: Array, heading: float
) -> Plan:
    """The right arm's: pick up, carry to the exchange, wait there until the object is taken, and go."""
    at, way, meeting = schedule(task), task.timing.ticks_per_waypoint, exchange(task)
    T_start = layout.T_in_world[task.object.name]
    closed, opened = _openings(task, hold)
    giving = meeting.take_ticks + meeting.both_ticks
    waypoints = (
        _waypoint("pre-grasp", raised(T_start, task.heights.approach), way, opened),
        _waypoint("grasp", T_start, way, closed),
        _waypoint("lift", raised(T_start, task.heights.lift), way, closed, stop=False),
        _waypoint("exchange", T_exchange, meeting.carry_ticks, closed),
        Waypoint("give", T_exchange, giving, True, opened, fingers_from=meeting.take_ticks / giving),
        _waypoint("withdraw", _aside(task, T_exchange, heading + math.pi), way, opened),
    )
    return Plan(
        object=task.object.name,
        T_object_in_pinch=inverse(leaning(hold, _outwards(T_start, T_base_in_world))),
        waypoints=waypoints,
        grasp=1,
        release=4,
        weld=True,
        phases=phases(task)[0],
        settle_ticks=at.total - sum(waypoint.ticks for waypoint in waypoints),
    )


def taking_plan(
    task: TaskConfig, layout: Layout, T_base_in_world: Array, hold: Hold, T_exchange: Array, heading: float
) -> Plan:
    """The left arm's: come near, take the object, wait until it is given, carry it to the target, and put it down.

    On its way from the exchange the object is turned as far as the arm turns about its base.
    """
    at, way, meeting, heights = schedule(task), task.timing.ticks_per_waypoint, exchange(task), task.heights
    T_target = layout.T_in_world[task.target.name]
    turn = azimuth(T_target, T_base_in_world) - azimuth(T_exchange, T_base_in_world)
    T_goal = T_target.copy()
    T_goal[:3, :3] = rotation_z(yaw(T_exchange) + turn)
    T_goal[2, 3] += task.target.support_height + task.object.rest_height
    T_arc = pose(
        [*(T_exchange[:2, 3] + T_goal[:2, 3]) / 2, max(T_exchange[2, 3], T_goal[2, 3] + heights.arc)],
        interpolate_rotation(T_exchange[:3, :3], T_goal[:3, :3], 0.5),
    )
    closed, opened = _openings(task, hold)
    half = meeting.carry_ticks // 2
    waypoints = (
        _waypoint("pre-take", _aside(task, T_exchange, heading), at.met, opened),
        _waypoint("take", T_exchange, meeting.take_ticks, closed),
        _waypoint("hold", T_exchange, meeting.both_ticks + way // 2, closed),
        _waypoint("arc-top", T_arc, half, closed, stop=False),
        _waypoint("pre-place", raised(T_goal, heights.approach), meeting.carry_ticks - half, closed),
        _waypoint("place", raised(T_goal, heights.release), way, opened),
        _waypoint("retract", raised(T_goal, heights.approach), way, opened),
    )
    return Plan(
        object=task.object.name,
        T_object_in_pinch=inverse(leaning(hold, _outwards(T_exchange, T_base_in_world))),
        waypoints=waypoints,
        grasp=1,
        release=5,
        weld=True,
        phases=phases(task)[1],
        settle_ticks=task.timing.settle_ticks,
    )


def _openings(task: TaskConfig, hold: Hold) -> tuple[float, float]:
    """Of one finger, closed and open, m."""
    assert task.object.grasp is not None  # checked when the config was loaded
    return hold.point.opening, hold.point.opening + task.object.grasp.clearance


def _waypoint(name: str, T: Array, ticks: int, opening: float, *, stop: bool = True) -> Waypoint:
    return Waypoint(name, T, ticks, stop, opening, fingers_from=WELD_FINGERS_FROM)
