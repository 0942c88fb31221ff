"""Pick an object up and put it onto another: where they start, what the hand does, and whether it worked."""

from __future__ import annotations

import math

import numpy as np

from ..config.scene import ObjectConfig, Table
from ..config.task import TaskConfig
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose, rotation_z, yaw
from ..types import Cause, Layout, Outcome, Plan, Waypoint

# The crank fingers' joint ends at 37.5 mm. Source: MuJoCo Menagerie i2rt_yam, `left_finger` range.
OPEN = 0.0375

# Objects start this far above what they lie on, so that no contact exists before the first step.
SPAWN_GAP = 2e-4

# Enough that a draw fails only for a box too small for both objects.
_MAX_DRAWS = 1000

# An object that moved this far before the grasp was knocked by the hand.
KNOCK_DISTANCE = 0.02


def sample_layout(task: TaskConfig, table: Table, rng: np.random.Generator) -> Layout | None:
    """Draw where the object and the target start.

    Returns:
        The layout, or None when no free place for the target was found in 1000 draws.
    """
    box = task.sampling
    T_object = _draw(task.object, box.x, box.y, box.object_yaw_deg, table, rng)
    for _ in range(_MAX_DRAWS):
        T_target = _draw(task.target, box.x, box.y, box.target_yaw_deg, table, rng)
        apart = float(np.hypot(*(T_object[:2, 3] - T_target[:2, 3])))
        if apart >= box.min_separation and _gap(task.object, T_object, task.target, T_target) >= box.clearance:
            return Layout({task.object.name: T_object, task.target.name: T_target})
    return None


def _draw(
    item: ObjectConfig,
    x: tuple[float, float],
    y: tuple[float, float],
    yaw_deg: tuple[float, float],
    table: Table,
    rng: np.random.Generator,
) -> Array:
    position = (rng.uniform(*x), rng.uniform(*y), table.top + item.rest_height + SPAWN_GAP)
    return pose(position, rotation_z(math.radians(rng.uniform(*yaw_deg))))


def _gap(item: ObjectConfig, T_item: Array, other: ObjectConfig, T_other: Array) -> float:
    """The gap in metres between two objects' outlines seen from above, the fingers around the first counted in.

    Negative when they overlap.
    """
    fingers = item.grasp.fingers(OPEN) if item.grasp else ()
    discs_a, discs_b = (
        np.array([[*(T @ (x, y, 0, 1))[:2], radius] for x, y, radius in discs])
        for discs, T in ((item.footprint + fingers, T_item), (other.footprint, T_other))
    )
    centres = np.linalg.norm(discs_a[:, None, :2] - discs_b[None, :, :2], axis=-1)
    return float((centres - discs_a[:, None, 2] - discs_b[None, :, 2]).min())


def candidate_plans(task: TaskConfig, layout: Layout, T_base_in_world: Array) -> tuple[Plan, ...]:
    """The plans to try: the hand may take the object either way round.

    The object is turned on its way as far as the arm turns about its base, so that the wrist hardly has to.
    """
    return tuple(_plan(task, layout, T_base_in_world, flipped) for flipped in (False, True))


def _plan(task: TaskConfig, layout: Layout, T_base_in_world: Array, flipped: bool) -> Plan:
    grasp = task.object.grasp
    assert grasp is not None  # checked when the config was loaded
    heights = task.heights
    T_start = layout.T_in_world[task.object.name]
    T_target = layout.T_in_world[task.target.name]

    turn = _azimuth(T_target, T_base_in_world) - _azimuth(T_start, T_base_in_world)
    T_goal = T_target.copy()
    T_goal[:3, :3] = rotation_z(yaw(T_start) + turn)
    T_goal[2, 3] += task.target.support_height + task.object.rest_height

    T_arc = pose(
        [*(T_start[:2, 3] + T_goal[:2, 3]) / 2, max(T_start[2, 3], T_goal[2, 3]) + heights.arc],
        interpolate_rotation(T_start[:3, :3], T_goal[:3, :3], 0.5),
    )
    closed = grasp.opening
    return Plan(
        object=task.object.name,
        T_object_in_pinch=inverse(grasp.T_pinch_in_object(flipped)),
        waypoints=(
            Waypoint("pre-grasp", _raised(T_start, heights.approach), OPEN, stop=True),
            Waypoint("grasp", T_start, OPEN, stop=True),
            Waypoint("lift", _raised(T_start, heights.lift), closed, stop=False),
            Waypoint("arc-top", T_arc, closed, stop=False),
            Waypoint("pre-place", _raised(T_goal, heights.approach), closed, stop=True),
            Waypoint("place", _raised(T_goal, heights.release), closed, stop=True),
            Waypoint("retract", _raised(T_goal, heights.approach), OPEN, stop=True),
        ),
        grasp=1,
        release=5,
    )


def _raised(T: Array, height: float) -> Array:
    raised = T.copy()
    raised[2, 3] += height
    return raised


def _azimuth(T_in_world: Array, T_base_in_world: Array) -> float:
    x, y = (inverse(T_base_in_world) @ T_in_world)[:2, 3]
    return math.atan2(y, x)


def knocked(T_at_start: Array, T_before_grasp: Array, plan_error: float, tilt: float) -> Outcome | None:
    """The failure of an attempt whose hand pushed the object away before it took it; None if it did not."""
    distance = float(np.linalg.norm(T_before_grasp[:3, 3] - T_at_start[:3, 3]))
    if distance <= KNOCK_DISTANCE:
        return None
    detail = f"pushed {distance * 1000:.0f} mm away before the grasp (at most {KNOCK_DISTANCE * 1000:.0f})"
    return Outcome(False, Cause.KNOCKED, detail, position_error=plan_error, tilt=tilt)


def judge(
    task: TaskConfig, T_object_in_world: Array, T_target_in_world: Array, speed: float, plan_error: float, tilt: float
) -> Outcome:
    """Tell how an episode ended from the final poses (4, 4), the object's speed (m/s) and the plan's own figures."""
    limits = task.success
    dx, dy, dz = (float(d) for d in T_object_in_world[:3, 3] - T_target_in_world[:3, 3])
    dxy = math.hypot(dx, dy)
    cause, detail = None, ""
    if speed > limits.max_speed:
        cause, detail = Cause.UNSTABLE, f"still moving at {speed:.3f} m/s, at most {limits.max_speed:g}"
    elif dz < 0.0:
        cause, detail = (
            Cause.DROPPED,
            f"{-dz * 1000:.0f} mm below the {task.target.name}, {dxy * 1000:.0f} mm beside its centre",
        )
    elif dxy > limits.threshold or dz > limits.max_height:
        cause = Cause.OFF_TARGET
        detail = (
            f"{dxy * 1000:.0f} mm from the {task.target.name}'s centre (at most {limits.threshold * 1000:.0f}), "
            f"{dz * 1000:.0f} mm above it (at most {limits.max_height * 1000:.0f})"
        )
    return Outcome(cause is None, cause, detail, dxy, dz, speed, plan_error, tilt)
