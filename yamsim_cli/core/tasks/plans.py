"""What the hand does to pick an object up and put it onto another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config.recording import GraspKind
from ..config.task import TaskConfig, Timing
from ..config.things import GraspPoint
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose, rotation_from_vector, rotation_z, yaw
from ..types import Holds, Layout, Phases, Plan, Waypoint

# A weld's fingers close, and open, in the last part of the way to the grasp, and to the place: the hand never stands
# still to wait for them, and the weld lets go only once they are open.
WELD_FINGERS_FROM = 0.7


@dataclass(frozen=True)
class Hold:
    """One of the ways in which the hand may hold the object.

    Attributes:
        point: where.
        flipped: the other way round about the approach.
        lean: of the hand from straight down, its fingers pointing away from the arm's base, rad.
    """

    point: GraspPoint
    flipped: bool
    lean: float = 0.0


def grasp_points(task: TaskConfig, grasp: GraspKind) -> tuple[GraspPoint, ...]:
    """Where the object may be held, the best place first."""
    held = task.object.grasp
    assert held is not None  # checked when the config was loaded
    if grasp == "weld":
        return (held,)
    assert held.friction is not None  # likewise
    return held.friction.points


def phases(task: TaskConfig, grasp: GraspKind) -> Phases:
    """When the object is in hand; it depends on nothing that is random."""
    way, grip = task.timing.ticks_per_waypoint, 0 if grasp == "weld" else task.timing.grip_ticks
    return Phases(reached=2 * way, held=range(2 * way + grip, 6 * way + grip))


def ticks(task: TaskConfig, grasp: GraspKind) -> int:
    """Control ticks of an attempt."""
    # From the release, the fingers open as long as they took to close.
    held = phases(task, grasp).held
    grip = held.start - 2 * task.timing.ticks_per_waypoint
    return held.stop + grip + task.timing.ticks_per_waypoint + task.timing.settle_ticks


def phases_of(magnet: Sequence[Holds]) -> tuple[Phases, ...]:
    """When the object was in each arm's hand where nothing was planned: while its weld held it, from first to last."""
    held = np.array([np.atleast_1d(holds) for holds in magnet])
    return tuple(_phase_of(np.flatnonzero(of_arm), len(held), arm) for arm, of_arm in enumerate(held.T))


def _phase_of(on: NDArray[np.int_], ticks: int, arm: int) -> Phases:
    if not len(on):
        return Phases(reached=ticks, held=range(0), arm=arm)
    return Phases(reached=int(on[0]), held=range(int(on[0]), int(on[-1]) + 1), arm=arm)


def make_plan(task: TaskConfig, grasp: GraspKind, layout: Layout, T_base_in_world: Array, hold: Hold) -> Plan:
    """Pick up, carry and put down, held in one way.

    The object is turned on its way as far as the arm turns about its base, so that the wrist hardly has to, and a hand
    that leans outwards does so all the way.
    """
    heights = task.heights
    T_start = layout.T_in_world[task.object.name]
    T_target = layout.T_in_world[task.target.name]
    outwards = azimuth(T_start, T_base_in_world)
    T_goal = T_target.copy()
    T_goal[:3, :3] = rotation_z(yaw(T_start) + azimuth(T_target, T_base_in_world) - outwards)
    T_goal[2, 3] += task.target.support_height + task.object.rest_height
    T_arc = pose(
        [*(T_start[:2, 3] + T_goal[:2, 3]) / 2, max(T_start[2, 3], T_goal[2, 3]) + heights.arc],
        interpolate_rotation(T_start[:3, :3], T_goal[:3, :3], 0.5),
    )
    way = {
        "pre-grasp": raised(T_start, heights.approach),
        "grasp": T_start,
        "lift": raised(T_start, heights.lift),
        "arc-top": T_arc,
        "pre-place": raised(T_goal, heights.approach),
        "place": raised(T_goal, heights.release),
        "retract": raised(T_goal, heights.approach),
    }
    taken = task.object.grasp
    assert taken is not None  # checked when the config was loaded
    closed, opened = hold.point.opening, hold.point.opening + taken.clearance
    if grasp == "weld":
        waypoints = _welded(task.timing, way, closed, opened)
    else:
        assert taken.friction is not None  # likewise
        waypoints = _gripped(task.timing, way, closed, opened, taken.friction.force)
    names = [waypoint.name for waypoint in waypoints]
    # From the base to the object, as seen from the object.
    outwards += yaw(T_base_in_world) - yaw(T_start)
    return Plan(
        object=task.object.name,
        T_object_in_pinch=inverse(leaning(hold, outwards)),
        waypoints=waypoints,
        grasp=names.index("grasp"),
        release=names.index("place"),
        weld=grasp == "weld",
        phases=phases(task, grasp),
        settle_ticks=task.timing.settle_ticks,
    )


def _welded(timing: Timing, way: dict[str, Array], closed: float, opened: float) -> tuple[Waypoint, ...]:
    """The fingers only look as if they held: they close, and open, on the way."""

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
    """The hand stands still while the fingers close to a force, and while they open."""

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
    """The pinch frame (4, 4) in the object's; `outwards` is the heading there of what leads away from the base, rad."""
    T = hold.point.T_pinch_in_object(hold.flipped)
    # About the horizontal axis to the right of `outwards`: what points down comes to point outwards.
    axis = (math.sin(outwards), -math.cos(outwards), 0.0)
    T[:3, :3] = rotation_from_vector([hold.lean * part for part in axis]) @ T[:3, :3]
    return T


def raised(T: Array, height: float) -> Array:
    """The same pose (4, 4), so many metres higher."""
    T_raised = T.copy()
    T_raised[2, 3] += height
    return T_raised


def azimuth(T_in_world: Array, T_base_in_world: Array) -> float:
    """Heading of a pose's place as seen from a base, in its frame, rad."""
    x, y = (inverse(T_base_in_world) @ T_in_world)[:2, 3]
    return math.atan2(y, x)
