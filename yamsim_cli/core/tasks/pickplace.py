"""Picking an object up and putting it onto another: sampling where they start, and judging how it ended."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..config.recording import GraspKind, RecordConfig
from ..config.scene import Table
from ..config.task import TaskConfig
from ..config.things.thing import ObjectConfig
from ..geometry.se3 import Array, pose, rotation_z
from ..types import Cause, Layout, Motion, Outcome

# Objects start this far above what they lie on, so that no contact exists before the first step.
SPAWN_GAP = 2e-4

# Tries to find a free place for the target. So many fail only if the box is too small for both objects.
_MAX_TRIES = 1000

# An object that moves farther than this before the grasp was knocked by the hand, m.
KNOCK_DISTANCE = 0.02
# An object that moves farther than this in the hand has slipped, m.
SLIP_DISTANCE = 0.015

# Contacts are soft in physics: an object sinks into what it lies on by a fraction of this, m.
_SUNK = 1e-3

# Stops are soft in physics: a joint may be beyond its stop by this, rad.
_STOP_SLACK = 0.01


@dataclass(frozen=True)
class Poses:
    """The poses (4, 4) in `world` by which an attempt is judged.

    Attributes:
        T_object_at_start: the object's pose at the start.
        T_object_before_grasp: its pose when the hand had reached it.
        T_object_at_end: its pose at the end.
        T_target_at_end: the target's pose at the end.
    """

    T_object_at_start: Array
    T_object_before_grasp: Array
    T_object_at_end: Array
    T_target_at_end: Array


def sample_layout(config: RecordConfig, rng: np.random.Generator) -> Layout | None:
    """Where the object and the target start, sampled.

    Returns:
        The layout, or None when none of 1000 places for the target was free.
    """
    task, table, box = config.pair, config.table, config.pair.sampling
    object_box, target_box = config.object_box, config.target_box
    T_object = _sample_pose(task.object, object_box.x, object_box.y, box.object_yaw_deg, table, rng)
    for _ in range(_MAX_TRIES):
        T_target = _sample_pose(task.target, target_box.x, target_box.y, box.target_yaw_deg, table, rng)
        apart = float(np.hypot(*(T_object[:2, 3] - T_target[:2, 3])))
        if apart >= box.min_separation and _gap(config, T_object, T_target) >= box.clearance:
            return Layout({task.object.name: T_object, task.target.name: T_target})
    return None


def _sample_pose(
    item: ObjectConfig,
    x: tuple[float, float],
    y: tuple[float, float],
    yaw_deg: tuple[float, float],
    table: Table,
    rng: np.random.Generator,
) -> Array:
    position = (rng.uniform(*x), rng.uniform(*y), table.top + item.rest_height + SPAWN_GAP)
    return pose(position, rotation_z(math.radians(rng.uniform(*yaw_deg))))


def _gap(config: RecordConfig, T_object: Array, T_target: Array) -> float:
    """The gap in metres between the outlines of object and target seen from above, the fingers around the object, as
    they come down on it, counted in.

    It is negative if they overlap.
    """
    item, hand = config.pair.object, config.picking_fingers
    assert item.grasp is not None  # checked when the config was loaded
    fingers = item.grasp.fingers(hand.opened, hand.radius)
    discs_a, discs_b = (
        np.array([[*(T @ (x, y, 0, 1))[:2], radius] for x, y, radius in discs])
        for discs, T in ((item.footprint + fingers, T_object), (config.pair.target.footprint, T_target))
    )
    centres = np.linalg.norm(discs_a[:, None, :2] - discs_b[None, :, :2], axis=-1)
    return float((centres - discs_a[:, None, 2] - discs_b[None, :, 2]).min())


def judge(
    task: TaskConfig,
    grasp: GraspKind,
    poses: Poses,
    speed: float,
    motion: Motion,
    *,
    planned: bool,
) -> Outcome:
    """How an attempt ended, without the plan's own figures.

    Args:
        poses: the poses of object and target.
        speed: the object's speed at the end, m/s.
        motion: what was observed on the way.
        planned: whether it is a planned demonstration, which must touch nothing and keep all limits. A person or a
            policy is judged only by the object; the margins tell how the arm moved.
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
    return Outcome(cause is None, cause, detail, dxy, dz, speed, margins=motion.margins)


def _before_the_grasp(poses: Poses) -> tuple[Cause, str] | None:
    distance = float(np.linalg.norm(poses.T_object_before_grasp[:3, 3] - poses.T_object_at_start[:3, 3]))
    if distance <= KNOCK_DISTANCE:
        return None
    most = f"at most {KNOCK_DISTANCE * 1000:.0f}"
    return Cause.KNOCKED, f"pushed {distance * 1000:.0f} mm away before the grasp ({most})"


def _on_the_way(grasp: GraspKind, motion: Motion) -> tuple[Cause, str] | None:
    """Cause and detail of what spoils a demonstration, wherever the object ends; None if nothing does."""
    margins = motion.margins
    if motion.collision is None and grasp == "contact" and motion.lost is not None:
        return Cause.DROPPED, f"out of the fingers after {motion.lost:.2f} s, before it was put down"
    if motion.collision is None and grasp == "contact" and (margins.slip or 0.0) > SLIP_DISTANCE:
        most = f"at most {SLIP_DISTANCE * 1000:.0f}"
        return Cause.SLIPPED, f"moved {(margins.slip or 0.0) * 1000:.0f} mm in the hand while it was held ({most})"
    return on_the_way(motion)


def on_the_way(motion: Motion) -> tuple[Cause, str] | None:
    """Cause and detail of what spoils any demonstration: arms that touch what they must not, or go to their limits."""
    margins = motion.margins
    if motion.collision is not None:
        return Cause.COLLIDED, motion.collision
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
    # Below the target's support it lies beside the target, however near, such as on the table beside a can.
    if dz < task.target.support_height - _SUNK:
        below = (task.target.support_height - dz) * 1000
        return Cause.DROPPED, f"{below:.0f} mm below the {task.target.name}, {dxy * 1000:.0f} mm beside its centre"
    if dxy > limits.threshold or dz > limits.max_height:
        return Cause.OFF_TARGET, (
            f"{dxy * 1000:.0f} mm from the {task.target.name}'s centre (at most {limits.threshold * 1000:.0f}), "
            f"{dz * 1000:.0f} mm above it (at most {limits.max_height * 1000:.0f})"
        )
    return None
