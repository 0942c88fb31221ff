from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..attempt_data import ActionSequence, JointPath
from ..geometry.se3 import Array
from ..scene.compiled import ArmAddresses, CompiledScene, FingerAddresses


def drive_commands(arm: ArmAddresses, path: JointPath) -> Array:
    """Return the commands (n, dof) of an arm's joint drives on each control tick, rad.

    A drive's torque is `kp (ctrl - q) - kv qvel`. Its command is the reference plus `kv / kp` times the velocity,
    against the damping, plus the planned torque over `kp`. The arm then has neither lag nor overshoot.
    """
    references = (path.joints[:-1] + path.joints[1:]) / 2
    command = references + (arm.velocity_gain * path.velocities + path.torques) / arm.position_gain
    clipped: Array = np.clip(command, arm.ctrl_range[:, 0], arm.ctrl_range[:, 1])
    return clipped


def gripper_drive_commands(fingers: FingerAddresses, path: JointPath) -> Array:
    """Return a gripper drive's commands (n,), m: `opening - 2 grip_force / gain`, as two fingers share its force."""
    clipped: Array = np.clip(path.gripper - 2 * path.grip_force / fingers.gain, *fingers.ctrl_range)
    return clipped


def path_actions(scene: CompiledScene, paths: Sequence[JointPath]) -> ActionSequence:
    """Return the actions that make the arms follow their paths, which have the same length."""
    ctrl = np.zeros((len(paths[0].gripper), scene.model.nu))
    for arm, path in zip(scene.arms, paths, strict=True):
        ctrl[:, arm.arm_ctrl] = drive_commands(arm, path)
        if arm.fingers is not None:
            ctrl[:, arm.fingers.ctrl] = gripper_drive_commands(arm.fingers, path)
    magnet = np.column_stack([path.weld_on for path in paths])
    references = [
        path.joints[1:] if arm.fingers is None else np.column_stack([path.joints[1:], path.gripper])
        for arm, path in zip(scene.arms, paths, strict=True)
    ]
    return ActionSequence(ctrl, magnet, np.stack(references, axis=1))
