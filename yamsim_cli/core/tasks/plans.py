"""Plans of what the hand does to pick an object up and put it onto another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config.recording import GraspKind
from ..config.task import TaskConfig, Timing
from ..config.things.thing import GraspPoint
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose, rotation_from_vector, rotation_z, yaw
from ..types import Holds, Layout, Phases, Plan, Waypoint
from .resting import resting_height

# With a weld, fingers close on the way to the grasp, and open on the way to the place, after this share of it. So the
# hand never waits for them, and the weld lets go only when they are open.
WELD_FINGERS_FROM = 0.7

# How far a hand leans outwards that holds a wall which goes away from the arm: what suits the arm best, rad.
_ALONG_A_WALL = math.radians(15)


@dataclass(frozen=True)
class Hold:
    """One of the ways in which the hand may hold the object.

    Attributes:
        point: where it holds the object.
        flipped: whether the hand is turned by half a turn about its approach.
        lean: angle of the hand from straight down, with the fingers pointing away from the arm's base, rad; at a wall,
            by how much more it tilts than that.
    """

    point: GraspPoint
    flipped: bool
    lean: float = 0.0


def grasp_points(task: TaskConfig, grasp: GraspKind) -> tuple[GraspPoint, ...]:
    """The places where the object may be held, the best one first."""
    held = task.object.grasp
    assert held is not None  # checked when the config was loaded
    if grasp == "weld":
        return (held,)
    assert held.friction is not None  # likewise
    return held.friction.points


def points_for(task: TaskConfig, grasp: GraspKind, layout: Layout, T_base_in_world: Array) -> tuple[GraspPoint, ...]:
    """The places where the object may be held as it stands, the best one first.

    Of those that go round an object, the best is where a hand that leans outwards lies on it with both pads: closing
    across the direction away from the base, or on the near side of a wall that leans.
    """
    points = grasp_points(task, grasp)
    taken = task.object.grasp
    if grasp == "weld" or taken is None or taken.friction is None or not taken.friction.around:
        return points
    outwards = _outwards(layout.T_in_world[task.object.name], T_base_in_world)

    def unsuited(point: GraspPoint) -> float:
        along = math.cos(math.radians(point.axis_deg) - outwards)
        return round(1 - along if point.tilt_deg is not None else abs(along), 3)

    return tuple(sorted(points, key=unsuited))


def start_opening(task: TaskConfig, grasp: GraspKind) -> float:
    """How far each finger is open at the start, m: as it is before it takes the object by its first grasp point."""
    taken = task.object.grasp
    assert taken is not None  # checked when the config was loaded
    return grasp_points(task, grasp)[0].opening + taken.clearance


def phases(task: TaskConfig, grasp: GraspKind) -> Phases:
    """When the object is in the hand; it does not depend on anything random."""
    way, grip = task.timing.ticks_per_waypoint, 0 if grasp == "weld" else task.timing.grip_ticks
    return Phases(reached=2 * way, held=range(2 * way + grip, 6 * way + grip))


def ticks(task: TaskConfig, grasp: GraspKind) -> int:
    """The number of control ticks of an attempt."""
    # After the release, the fingers take as long to open as they took to close.
    held = phases(task, grasp).held
    grip = held.start - 2 * task.timing.ticks_per_waypoint
    return held.stop + grip + task.timing.ticks_per_waypoint + task.timing.settle_ticks


def phases_of(magnet: Holds) -> tuple[Phases, ...]:
    """When the object was in each arm's hand, for attempts without a plan: from the first tick of its weld to the last.

    Args:
        magnet: whether each arm's weld holds on each tick (ticks, arms).
    """
    return tuple(_phase_of(np.flatnonzero(held), len(magnet), arm) for arm, held in enumerate(magnet.T))


def _phase_of(on: NDArray[np.int_], ticks: int, arm: int) -> Phases:
    if not len(on):
        return Phases(reached=ticks, held=range(0), arm=arm)
    return Phases(reached=int(on[0]), held=range(int(on[0]), int(on[-1]) + 1), arm=arm)


def make_plan(task: TaskConfig, grasp: GraspKind, layout: Layout, T_base_in_world: Array, hold: Hold) -> Plan:
    """The plan to pick up, carry and put down, with the object held in one way.

    On its way, the object turns as far as the arm turns about its base. So the wrist hardly has to turn, and a hand
    that leans outwards does so all the way.
    """
    heights = task.heights
    T_start = layout.T_in_world[task.object.name]
    T_target = layout.T_in_world[task.target.name]
    outwards = azimuth(T_start, T_base_in_world)
    T_goal = T_target.copy()
    T_goal[:3, :3] = rotation_z(yaw(T_start) + azimuth(T_target, T_base_in_world) - outwards)
    T_goal[2, 3] += resting_height(task.object, task.target)
    T_arc = pose(
        [*(T_start[:2, 3] + T_goal[:2, 3]) / 2, max(T_start[2, 3], T_goal[2, 3]) + heights.arc],
        interpolate_rotation(T_start[:3, :3], T_goal[:3, :3], 0.5),
    )
    T_pinch_in_object = leaning(hold, _outwards(T_start, T_base_in_world))
    T_place = raised(T_goal, heights.release)
    way = {
        "pre-grasp": raised(T_start, heights.approach),
        "grasp": T_start,
        "lift": raised(T_start, heights.lift),
        "arc-top": T_arc,
        "pre-place": raised(T_goal, heights.approach),
        "place": T_place,
        "retract": raised(T_goal, heights.approach),
    }
    if hold.point.tilt_deg is not None:
        # Along the wall that is between the fingers, which would run into it otherwise.
        way["pre-grasp"] = _withdrawn(T_start, T_pinch_in_object, heights.approach)
        way["retract"] = _withdrawn(T_place, T_pinch_in_object, heights.approach)
    taken = task.object.grasp
    assert taken is not None  # checked when the config was loaded
    closed, opened = hold.point.opening, hold.point.opening + taken.clearance
    if grasp == "weld":
        waypoints = _welded(task.timing, way, closed, opened)
    else:
        assert taken.friction is not None  # likewise
        waypoints = _gripped(task.timing, way, closed, opened, taken.friction.force)
    names = [waypoint.name for waypoint in waypoints]
    return Plan(
        object=task.object.name,
        T_object_in_pinch=inverse(T_pinch_in_object),
        waypoints=waypoints,
        grasp=names.index("grasp"),
        release=names.index("place"),
        weld=grasp == "weld",
        phases=phases(task, grasp),
        settle_ticks=task.timing.settle_ticks,
    )


def _welded(timing: Timing, way: dict[str, Array], closed: float, opened: float) -> tuple[Waypoint, ...]:
    """The waypoints with a weld: the fingers only seem to hold the object, and close and open on the way."""

    def waypoint(name: str, opening: float, *, stop: bool = True) -> Waypoint:
        return Waypoint(name, way[name], timing.ticks_per_waypoint, stop, opening, fingers_from=WELD_FINGERS_FROM)

    return (
        waypoint("pre-grasp", opened),
        waypoint("grasp", closed),
        waypoint("lift", closed, stop=False),
        waypoint("arc-top", closed, stop=False),
        waypoint("pre-place", closed),
        waypoint("place", opened),
        waypoint("retract", opened),
    )


def _gripped(timing: Timing, way: dict[str, Array], closed: float, opened: float, force: float) -> tuple[Waypoint, ...]:
    """The waypoints with friction: the hand stands still while the fingers close to a force, and while they open."""

    def waypoint(name: str, opening: float, grip: float = 0.0, *, stop: bool = True) -> Waypoint:
        return Waypoint(name, way[name], timing.ticks_per_waypoint, stop, opening, grip)

    return (
        waypoint("pre-grasp", opened),
        waypoint("grasp", opened),
        Waypoint("close", way["grasp"], timing.grip_ticks, True, closed, force),
        waypoint("lift", closed, force, stop=False),
        waypoint("arc-top", closed, force, stop=False),
        waypoint("pre-place", closed, force),
        waypoint("place", closed, force),
        Waypoint("open", way["place"], timing.grip_ticks, True, opened),
        waypoint("retract", opened),
    )


def leaning(hold: Hold, outwards: float) -> Array:
    """The pinch frame (4, 4) in the object's frame.

    Args:
        outwards: heading of the direction away from the base, in the object's frame, rad.
    """
    T = hold.point.T_pinch_in_object(hold.flipped)
    if hold.point.tilt_deg is not None:
        # The hand leans outwards only so far as its pads stay on the wall: about the axis along which they close.
        heading = math.radians(hold.point.axis_deg)
        closing = T[:3, 1] * math.copysign(1.0, T[0, 1] * math.cos(heading) + T[1, 1] * math.sin(heading))
        T[:3, :3] = rotation_from_vector(_ALONG_A_WALL * math.sin(outwards - heading) * closing) @ T[:3, :3]
        beside = (math.sin(heading), -math.cos(heading), 0.0)
        T[:3, :3] = rotation_from_vector([hold.lean * part for part in beside]) @ T[:3, :3]
        return T
    # A turn about the horizontal axis to the right of `outwards` lets the fingers point outwards.
    axis = (math.sin(outwards), -math.cos(outwards), 0.0)
    T[:3, :3] = rotation_from_vector([hold.lean * part for part in axis]) @ T[:3, :3]
    return T


def _withdrawn(T: Array, T_pinch_in_object: Array, by: float) -> Array:
    """The object's pose (4, 4) that goes with a hand `by` metres back from where it holds the object at `T`."""
    T_back = T.copy()
    T_back[:3, 3] -= by * (T @ T_pinch_in_object)[:3, 2]
    return T_back


def raised(T: Array, height: float) -> Array:
    """The same pose (4, 4), `height` metres higher."""
    T_raised = T.copy()
    T_raised[2, 3] += height
    return T_raised


def _outwards(T_in_world: Array, T_base_in_world: Array) -> float:
    """Heading of the direction from a base to an object, in the object's frame, rad."""
    return azimuth(T_in_world, T_base_in_world) + (yaw(T_base_in_world) - yaw(T_in_world))


def azimuth(T_in_world: Array, T_base_in_world: Array) -> float:
    """Heading from a base to a pose's position, in the base's frame, rad."""
    x, y = (inverse(T_base_in_world) @ T_in_world)[:2, 3]
    return math.atan2(y, x)
