"""Simulates actions without rendering, and keeps the states to be rendered later."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config.task import Timing
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm, SceneFingers
from ..types import Actions, JointPath, Layout, Motion, Phases, Stand, StepState
from .monitor import MotionMonitor, object_pose
from .readings import sensed


@dataclass(frozen=True)
class Rollout:
    """The result of a simulation.

    Attributes:
        states: a state for each recorded frame, taken before its command acts.
        T_at_start: object name -> pose (4, 4) in `world` at the start.
        T_object_before_grasp: pose (4, 4) of the carried object in `world` when the hand had reached it.
        T_in_world: object name -> pose (4, 4) in `world` at the end.
        object_speed: speed of the carried object at the end, m/s.
        motion: what was observed on the way.
    """

    states: tuple[StepState, ...]
    T_at_start: dict[str, Array]
    T_object_before_grasp: Array
    T_in_world: dict[str, Array]
    object_speed: float
    motion: Motion


def drive_command(arm: SceneArm, path: JointPath, tick: int) -> Array:
    """What the drives (dof,) of an arm's joints are told on one tick, rad.

    A drive pulls towards its command and damps all motion, with the torque `kp (ctrl - q) - kv qvel`. The command is
    the reference in the middle of the tick, plus what makes up for the damping (`kv / kp` times the velocity) and for
    the inertia (the torque over `kp`). So the arm neither lags behind its reference nor overshoots it.
    """
    reference = (path.joints[tick] + path.joints[tick + 1]) / 2
    command = reference + (arm.kv * path.velocities[tick] + path.torques[tick]) / arm.kp
    clipped: Array = np.clip(command, arm.ctrl_range[:, 0], arm.ctrl_range[:, 1])
    return clipped


def grip_command(fingers: SceneFingers, path: JointPath) -> Array:
    """What a gripper is told (n,), m: the opening, less what makes each finger press with half its force."""
    clipped: Array = np.clip(path.gripper - 2 * path.grip / fingers.gain, *fingers.ctrl_range)
    return clipped


def path_actions(scene: CompiledScene, paths: Sequence[JointPath]) -> Actions:
    """The actions that make each of the scene's arms follow its path; all paths have the same length."""
    ctrl = np.zeros((len(paths[0].gripper), scene.model.nu))
    for arm, path in zip(scene.arms, paths, strict=True):
        ctrl[:, arm.arm_ctrl] = [drive_command(arm, path, tick) for tick in range(len(ctrl))]
        if arm.fingers is not None:
            ctrl[:, arm.fingers.ctrl] = grip_command(arm.fingers, path)
    magnet = np.column_stack([path.magnet for path in paths])
    asked = [
        path.joints[1:] if arm.fingers is None else np.column_stack([path.joints[1:], path.gripper])
        for arm, path in zip(scene.arms, paths, strict=True)
    ]
    return Actions(ctrl, magnet, np.stack(asked, axis=1))


def path_start(scene: CompiledScene, layout: Layout, paths: Sequence[JointPath]) -> Array:
    """MuJoCo's positions (nq,) from which the scene's arms can follow their paths."""
    return scene.start_qpos(layout, [Stand(path.joints[0], float(path.gripper[0])) for path in paths])


def simulate(
    scene: CompiledScene,
    start: Array,
    actions: Actions,
    carried: str,
    timing: Timing,
    phases: Sequence[Phases],
    see: Callable[[mujoco.MjData], None] | None = None,
) -> Rollout:
    """The simulation of actions from a full reset at `start` (nq,), at rest. The same inputs give the same bits.

    Args:
        carried: name of the object that is picked up.
        phases: when it is held, and by which arm.
        see: called with the start, and with the state after every physics step, which it must not change.
    """
    model = scene.model
    data = mujoco.MjData(model)
    scene.reset(data, start)
    T_at_start = _object_poses(scene, data)
    if see:
        see(data)
    steps = timing.physics_steps_per_tick
    watch = MotionMonitor(scene, data, carried, phases, steps * len(actions.ctrl))
    states: list[StepState] = []
    for tick, ctrl in enumerate(actions.ctrl):
        # After mj_step, poses are those of the step before.
        mujoco.mj_kinematics(model, data)
        watch.tick(tick, data)
        for arm, holds in zip(scene.arms, actions.magnet[tick], strict=True):
            assert arm.weld is not None, "tasks of two things have welds"
            if holds and not data.eq_active[arm.weld]:
                attach(scene.model, arm, data, carried)
            data.eq_active[arm.weld] = holds
        data.ctrl[:] = ctrl
        if tick % timing.ticks_per_frame == 0:
            until = slice(tick, tick + timing.ticks_per_frame)
            acting = Actions(actions.ctrl[until], actions.magnet[until], actions.joints[until])
            states.append(StepState(data.time, data.qpos.copy(), acting, sensed(scene, data)))
        for _ in range(steps):
            scene.step(data)
            watch.step(data)
            if see:
                see(data)
        watch.end_tick(data)
    mujoco.mj_kinematics(model, data)
    dof = scene.object_dof[carried]
    return Rollout(
        states=tuple(states),
        T_at_start=T_at_start,
        T_object_before_grasp=watch.T_object_before_grasp,
        T_in_world=_object_poses(scene, data),
        object_speed=float(np.linalg.norm(data.qvel[dof : dof + 3])),
        motion=watch.motion(),
    )


def _object_poses(scene: CompiledScene, data: mujoco.MjData) -> dict[str, Array]:
    return {name: object_pose(data, name) for name in scene.object_qpos}


def attach(model: mujoco.MjModel, arm: SceneArm, data: mujoco.MjData, carried: str) -> None:
    """Write the object's present pose relative to the flange into the weld, so that switching it on moves nothing."""
    assert arm.weld is not None, "there is no weld where friction alone holds"
    hand, item = data.body(arm.flange), data.body(carried)
    position, quat, inverse_quat = np.empty(3), np.empty(4), np.empty(4)
    mujoco.mju_negQuat(inverse_quat, hand.xquat)
    mujoco.mju_rotVecQuat(position, item.xpos - hand.xpos, inverse_quat)
    mujoco.mju_mulQuat(quat, inverse_quat, item.xquat)
    # The anchor in the second body (3), the second body's position (3) and quaternion (4) in the first, and the torque
    # scale (1).
    model.eq_data[arm.weld, :11] = [0, 0, 0, *position, *quat, 1]
