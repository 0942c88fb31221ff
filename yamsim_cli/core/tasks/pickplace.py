"""Pick an object up and put it onto another: where they start, and whether it worked."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..config.objects import ObjectConfig
from ..config.record import GraspKind
from ..config.scene import Table
from ..config.task import Sampling, TaskConfig
from ..geometry.se3 import Array, pose, rotation_z
from ..types import Cause, Layout, Motion, Outcome

# The crank fingers' joint ends at 37.5 mm. Source: MuJoCo Menagerie i2rt_yam, `left_finger` range.
OPEN = 0.0375

# Objects start this far above what they lie on, so that no contact exists before the first step.
SPAWN_GAP = 2e-4

# Enough that a draw fails only for a box too small for both objects.
_MAX_DRAWS = 1000

# An object that moved this far before the grasp was knocked by the hand, and this far in the hand, slipped; m.
KNOCK_DISTANCE = 0.02
SLIP_DISTANCE = 0.015

# Contacts are soft in physics: what lies on something sinks in by a fraction of this, m.
_SUNK = 1e-3

# Stops are soft in physics, rad.
_STOP_SLACK = 0.01


@dataclass(frozen=True)
class Poses:
    """What an episode is judged by, (4, 4) in `world`.

    Attributes:
        T_object_at_start, T_object_before_grasp, T_object_at_end: the second when the hand had reached it.
        T_target_at_end: where it was put.
    """

    T_object_at_start: Array
    T_object_before_grasp: Array
    T_object_at_end: Array
    T_target_at_end: Array


def sample_layout(
    task: TaskConfig,
    table: Table,
    rng: np.random.Generator,
    object_box: Sampling | None = None,
    target_box: Sampling | None = None,
) -> Layout | None:
    """Draw where the object and the target start.

    Args:
        object_box, target_box: where from, see `RecordConfig`; if not given, the task's own box.

    Returns:
        The layout, or None when no free place for the target was found in 1000 draws.
    """
    box = task.sampling
    object_box, target_box = object_box or box, target_box or box
    T_object = _draw(task.object, object_box.x, object_box.y, box.object_yaw_deg, table, rng)
    for _ in range(_MAX_DRAWS):
        T_target = _draw(task.target, target_box.x, target_box.y, box.target_yaw_deg, table, rng)
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


def judge(
    task: TaskConfig,
    grasp: GraspKind,
    poses: Poses,
    speed: float,
    motion: Motion,
    plan_error: float,
    tilt: float,
    *,
    planned: bool = True,
) -> Outcome:
    """Tell how an episode ended.

    Args:
        poses: where object and target were and are.
        speed: of the object at the end, m/s.
        motion: what was seen on the way.
        plan_error, tilt: the plan's own figures, m and rad.
        planned: whether it is to be a demonstration, which touches nothing and keeps to all limits. Of a person or a
            policy, only what becomes of the object is asked; how it moved is told by the margins.
    """
    dx, dy, dz = (float(d) for d in poses.T_object_at_end[:3, 3] - poses.T_target_at_end[:3, 3])
    dxy = math.hypot(dx, dy)
    cause, detail = (
        ((Cause.UNSTABLE, motion.breakdown) if motion.breakdown else None)
        or _before_the_grasp(poses)
        or (_on_the_way(grasp, motion) if planned else None)
        or _at_the_end(task, dxy, dz, speed)
        or (None, "")
    )
    return Outcome(cause is None, cause, detail, dxy, dz, speed, plan_error, tilt, motion.margins)


def _before_the_grasp(poses: Poses) -> tuple[Cause, str] | None:
    distance = float(np.linalg.norm(poses.T_object_before_grasp[:3, 3] - poses.T_object_at_start[:3, 3]))
    if distance <= KNOCK_DISTANCE:
        return None
    most = f"at most {KNOCK_DISTANCE * 1000:.0f}"
    return Cause.KNOCKED, f"pushed {distance * 1000:.0f} mm away before the grasp ({most})"


def _on_the_way(grasp: GraspKind, motion: Motion) -> tuple[Cause, str] | None:
    """What makes a bad demonstration, wherever the object ends."""
    margins = motion.margins
    if motion.collision is not None:
        return Cause.COLLIDED, motion.collision
    if grasp == "contact" and motion.lost is not None:
        return Cause.DROPPED, f"out of the fingers after {motion.lost:.2f} s, before it was put down"
    if grasp == "contact" and margins.slip > SLIP_DISTANCE:
        most = f"at most {SLIP_DISTANCE * 1000:.0f}"
        return Cause.SLIPPED, f"moved {margins.slip * 1000:.0f} mm in the hand while it was held ({most})"
    if margins.velocity > 1 or margins.torque >= 1 or margins.joint < -_STOP_SLACK:
        detail = (
            f"a joint at {margins.velocity:.0%} of its motor's speed, a drive at {margins.torque:.0%} of its torque, "
            f"{math.degrees(margins.joint):.1f} deg from the nearest stop"
        )
        return Cause.LIMITS, detail
    return None


def _at_the_end(task: TaskConfig, dxy: float, dz: float, speed: float) -> tuple[Cause, str] | None:
    limits = task.success
    if speed > limits.max_speed:
        return Cause.UNSTABLE, f"still moving at {speed:.3f} m/s, at most {limits.max_speed:g}"
    # Under what carries it, it lies beside the target, however near: on the table beside a can, say.
    if dz < task.target.support_height - _SUNK:
        below = (task.target.support_height - dz) * 1000
        return Cause.DROPPED, f"{below:.0f} mm below the {task.target.name}, {dxy * 1000:.0f} mm beside its centre"
    if dxy > limits.threshold or dz > limits.max_height:
        return Cause.OFF_TARGET, (
            f"{dxy * 1000:.0f} mm from the {task.target.name}'s centre (at most {limits.threshold * 1000:.0f}), "
            f"{dz * 1000:.0f} mm above it (at most {limits.max_height * 1000:.0f})"
        )
    return None
