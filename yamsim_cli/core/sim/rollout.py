"""Run a joint path in physics, without drawing anything, and keep the states that will be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ..config.task import Timing
from ..geometry.se3 import Array, pose
from ..scene.compiled import CompiledScene
from ..types import JointPath, Layout, StepState


@dataclass(frozen=True)
class Rollout:
    """What physics made of a path.

    Attributes:
        states: one a recorded tick, taken before its command acts.
        T_object_before_grasp: pose (4, 4) of the object in `world` when it was attached.
        T_in_world: object name -> pose (4, 4) at the end.
        object_speed: of the carried object at the end, m/s.
        tracking_error: largest distance of a joint from its reference at the end of a tick, rad.
    """

    states: tuple[StepState, ...]
    T_object_before_grasp: Array
    T_in_world: dict[str, Array]
    object_speed: float
    tracking_error: float


def object_pose(data: mujoco.MjData, name: str) -> Array:
    """Pose (4, 4) of a body in `world`, as of the last forward kinematics."""
    body = data.body(name)
    return pose(body.xpos, body.xmat.reshape(3, 3))


def drive_command(scene: CompiledScene, path: JointPath, tick: int) -> Array:
    """What the arm's drives (6,) are told on one tick, rad.

    A drive pulls towards its command and brakes all motion: `kp (ctrl - q) - kv qvel`. So that the arm follows its
    reference, neither lagging behind nor swinging past, the command is the reference in the middle of the tick and, on
    top, what makes up for the brake (`kv / kp` of the velocity) and for the inertia (the torque over `kp`).
    """
    reference = (path.joints[tick] + path.joints[tick + 1]) / 2
    command = reference + (scene.kv * path.velocities[tick] + path.torques[tick]) / scene.kp
    clipped: Array = np.clip(command, scene.ctrl_range[:, 0], scene.ctrl_range[:, 1])
    return clipped


def roll_out(scene: CompiledScene, layout: Layout, path: JointPath, carried: str, timing: Timing) -> Rollout:
    """Simulate one attempt from a full reset; the same inputs give the same bits on one machine.

    Args:
        carried: name of the object the weld takes.
    """
    model = scene.model
    data = mujoco.MjData(model)
    scene.start(data, layout, path.joints[0], float(path.gripper[0]))
    states: list[StepState] = []
    T_before_grasp = object_pose(data, carried)
    tracking = 0.0
    for tick, reference in enumerate(path.joints[1:]):
        if path.magnet[tick] != bool(data.eq_active[scene.weld]):
            if path.magnet[tick]:
                # mj_step leaves the poses of the step before.
                mujoco.mj_kinematics(model, data)
                T_before_grasp = object_pose(data, carried)
                attach(scene, data, carried)
            data.eq_active[scene.weld] = path.magnet[tick]
        data.ctrl[scene.arm_ctrl] = drive_command(scene, path, tick)
        data.ctrl[scene.gripper_ctrl] = path.gripper[tick]
        if tick % timing.ticks_per_frame == 0:
            states.append(
                StepState(
                    data.time,
                    data.qpos.copy(),
                    data.ctrl.copy(),
                    np.append(reference, path.gripper[tick]),
                    path.magnet[tick],
                )
            )
        mujoco.mj_step(model, data, timing.physics_steps_per_tick)
        tracking = max(tracking, float(np.abs(data.qpos[scene.joint_qpos] - reference).max()))
    mujoco.mj_kinematics(model, data)
    dof = scene.object_dof[carried]
    return Rollout(
        states=tuple(states),
        T_object_before_grasp=T_before_grasp,
        T_in_world={name: object_pose(data, name) for name in layout.T_in_world},
        object_speed=float(np.linalg.norm(data.qvel[dof : dof + 3])),
        tracking_error=tracking,
    )


def attach(scene: CompiledScene, data: mujoco.MjData, carried: str) -> None:
    """Write the object's present pose relative to `link_6` into the weld, so that switching it on moves nothing."""
    model = scene.model
    hand, item = data.body("link_6"), data.body(carried)
    position, quat, inverse_quat = np.empty(3), np.empty(4), np.empty(4)
    mujoco.mju_negQuat(inverse_quat, hand.xquat)
    mujoco.mju_rotVecQuat(position, item.xpos - hand.xpos, inverse_quat)
    mujoco.mju_mulQuat(quat, inverse_quat, item.xquat)
    # Anchor in the second body (3), position (3) and quaternion (4) of the second body in the first, torque scale (1).
    model.eq_data[scene.weld, :11] = [0, 0, 0, *position, *quat, 1]
