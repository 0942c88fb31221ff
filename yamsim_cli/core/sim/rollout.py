"""Run a joint path, or recorded actions, in physics, without drawing, and keep the states that will be drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config.task import Timing
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..types import Actions, Holds, JointPath, Layout, Motion, Phases, StepState
from .watch import Watch, object_pose


@dataclass(frozen=True)
class Rollout:
    """What physics made of a path, or of recorded actions.

    Attributes:
        states: one a recorded frame, taken before its command acts.
        T_object_before_grasp: pose (4, 4) of the object in `world` when the hand had reached it.
        T_in_world: object name -> pose (4, 4) at the end.
        object_speed: of the carried object at the end, m/s.
        motion: what was seen on the way.
    """

    states: tuple[StepState, ...]
    T_object_before_grasp: Array
    T_in_world: dict[str, Array]
    object_speed: float
    motion: Motion


def drive_command(arm: SceneArm, path: JointPath, tick: int) -> Array:
    """What an arm's drives (6,) are told on one tick, rad.

    A drive pulls towards its command and brakes all motion: `kp (ctrl - q) - kv qvel`. So that the arm follows its
    reference, neither lagging behind nor swinging past, the command is the reference in the middle of the tick and, on
    top, what makes up for the brake (`kv / kp` of the velocity) and for the inertia (the torque over `kp`).
    """
    reference = (path.joints[tick] + path.joints[tick + 1]) / 2
    command = reference + (arm.kv * path.velocities[tick] + path.torques[tick]) / arm.kp
    clipped: Array = np.clip(command, arm.ctrl_range[:, 0], arm.ctrl_range[:, 1])
    return clipped


def grip_command(arm: SceneArm, path: JointPath) -> Array:
    """What an arm's gripper is told (n,), m: the opening, less what makes each finger press with half its force."""
    clipped: Array = np.clip(path.gripper - 2 * path.grip / arm.grip_gain, *arm.grip_range)
    return clipped


def path_actions(scene: CompiledScene, paths: Sequence[JointPath]) -> Actions:
    """What makes each of the scene's arms follow its path; all paths are of one length."""
    ctrl = np.zeros((len(paths[0].gripper), scene.model.nu))
    for arm, path in zip(scene.arms, paths, strict=True):
        ctrl[:, arm.arm_ctrl] = [drive_command(arm, path, tick) for tick in range(len(ctrl))]
        ctrl[:, arm.gripper_ctrl] = grip_command(arm, path)
    magnet: tuple[Holds, ...] = paths[0].magnet
    if len(paths) > 1:
        magnet = tuple(zip(*(path.magnet for path in paths), strict=True))
    joints = np.column_stack([part for path in paths for part in (path.joints[1:], path.gripper)])
    return Actions(ctrl, magnet, joints)


def roll_out(
    scene: CompiledScene,
    layout: Layout,
    paths: Sequence[JointPath],
    carried: str,
    timing: Timing,
    phases: Sequence[Phases],
) -> Rollout:
    """Simulate one attempt from a full reset; the same inputs give the same bits on one machine.

    Args:
        paths: of each of the scene's arms.
        carried: name of the object that is picked up.
        phases: when it is held, by which arm.
    """
    joints, openings = np.array([path.joints[0] for path in paths]), np.array([path.gripper[0] for path in paths])
    start = scene.start_qpos(layout, joints, openings)
    return simulate(scene, start, path_actions(scene, paths), carried, timing, phases)


def simulate(
    scene: CompiledScene,
    start: Array,
    actions: Actions,
    carried: str,
    timing: Timing,
    phases: Sequence[Phases],
    see: Callable[[mujoco.MjData], None] | None = None,
) -> Rollout:
    """Let actions act from a full reset at `start` (nq,), everything at rest; the same inputs give the same bits.

    Args:
        carried: name of the object that is picked up.
        phases: when it is held, by which arm.
        see: is shown the start, and the state after every physics step; it must not change it.
    """
    model = scene.model
    data = mujoco.MjData(model)
    scene.reset(data, start)
    if see:
        see(data)
    steps = timing.physics_steps_per_tick
    watch = Watch(scene, data, carried, phases, steps * len(actions.ctrl))
    states: list[StepState] = []
    for tick, ctrl in enumerate(actions.ctrl):
        # mj_step leaves the poses of the step before.
        mujoco.mj_kinematics(model, data)
        watch.tick(tick, data)
        for arm, holds in zip(scene.arms, np.atleast_1d(actions.magnet[tick]), strict=True):
            if holds and not data.eq_active[arm.weld]:
                attach(scene.model, arm, data, carried)
            data.eq_active[arm.weld] = holds
        data.ctrl[:] = ctrl
        if tick % timing.ticks_per_frame == 0:
            until = slice(tick, tick + timing.ticks_per_frame)
            acting = Actions(actions.ctrl[until], actions.magnet[until], actions.joints[until])
            states.append(StepState(data.time, data.qpos.copy(), acting))
        for _ in range(steps):
            mujoco.mj_step(model, data)
            watch.step(data)
            if see:
                see(data)
        watch.end_tick(data)
    mujoco.mj_kinematics(model, data)
    dof = scene.object_dof[carried]
    return Rollout(
        states=tuple(states),
        T_object_before_grasp=watch.T_object_before_grasp,
        T_in_world={name: object_pose(data, name) for name in scene.object_qpos},
        object_speed=float(np.linalg.norm(data.qvel[dof : dof + 3])),
        motion=watch.motion(),
    )


def attach(model: mujoco.MjModel, arm: SceneArm, data: mujoco.MjData, carried: str) -> None:
    """Write the object's present pose relative to `link_6` into the weld, so that switching it on moves nothing."""
    hand, item = data.body(f"{arm.prefix}link_6"), data.body(carried)
    position, quat, inverse_quat = np.empty(3), np.empty(4), np.empty(4)
    mujoco.mju_negQuat(inverse_quat, hand.xquat)
    mujoco.mju_rotVecQuat(position, item.xpos - hand.xpos, inverse_quat)
    mujoco.mju_mulQuat(quat, inverse_quat, item.xquat)
    # Anchor in the second body (3), position (3) and quaternion (4) of the second body in the first, torque scale (1).
    model.eq_data[arm.weld, :11] = [0, 0, 0, *position, *quat, 1]
