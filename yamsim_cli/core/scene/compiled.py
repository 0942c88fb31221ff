"""A compiled scene, and where its parts lie in MuJoCo's arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, quat_from_rotation
from ..types import Layout

Ids = NDArray[np.int_]


class Kind(IntEnum):
    """What a geom belongs to."""

    OTHER = 0
    ARM = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    TABLE = 4
    OBJECT = 5
    TARGET = 6


# Which kinds of geoms must not touch: the arm, fingers included, and what the object lies on or is to lie on.
FORBIDDEN = np.zeros((len(Kind), len(Kind)), dtype=bool)
for _part in (Kind.ARM, Kind.LEFT_FINGER, Kind.RIGHT_FINGER):
    for _thing in (Kind.TABLE, Kind.TARGET):
        FORBIDDEN[_part, _thing] = FORBIDDEN[_thing, _part] = True


@dataclass(frozen=True)
class CompiledScene:
    """A model with the addresses that stepping and recording need.

    Attributes:
        model: the compiled MuJoCo model; treat as constant outside an attempt (the weld's target is written into it).
        joint_qpos, joint_dof: addresses (6,) of the arm's joints in `qpos` and `qvel`.
        gripper_qpos, gripper_sign: addresses (2,) of the left and right finger in `qpos`, and whether each counts its
            opening up there (1) or down (-1).
        arm_ctrl, gripper_ctrl: the drives' places in `ctrl`.
        kp, kv: gains (6,) of the arm's drives, N m/rad and N m s/rad.
        ctrl_range: (6, 2) of the arm's drives, rad.
        weld: id of the equality that holds the object.
        object_qpos: object name -> address of its free joint in `qpos`.
        object_dof: object name -> address of its free joint in `qvel`.
        T_base_in_world: pose (4, 4) of the arm's base.
        cameras: names of the cameras to record, in order.
        geom_kind: `Kind` of every geom (ngeom,).
        joint_range, motor_speed, most_torque: of the arm's joints (6, 2) in rad, (6,) in rad/s and (6,) in N m.
        grip_gain: of the gripper's drive, N/m; both fingers share its force.
        grip_range: of what that drive can be told (2,), m.
    """

    model: mujoco.MjModel
    joint_qpos: Ids
    joint_dof: Ids
    gripper_qpos: Ids
    gripper_sign: Array
    arm_ctrl: Ids
    gripper_ctrl: int
    kp: Array
    kv: Array
    ctrl_range: Array
    weld: int
    object_qpos: Mapping[str, int]
    object_dof: Mapping[str, int]
    T_base_in_world: Array
    cameras: tuple[str, ...]
    geom_kind: Ids
    joint_range: Array
    motor_speed: Array
    most_torque: Array
    grip_gain: float
    grip_range: Array

    def start(self, data: mujoco.MjData, layout: Layout, joints: Array, gripper: float) -> None:
        """Reset `data` wholly and put arm and objects in place: bit for bit the same however `data` was used before."""
        self.reset(data, self.start_qpos(layout, joints, gripper))

    def start_qpos(self, layout: Layout, joints: Array, gripper: float) -> Array:
        """MuJoCo's positions (nq,) with the arm at `joints` (6,), both fingers at `gripper`, and the objects placed."""
        qpos: Array = self.model.qpos0.copy()
        qpos[self.joint_qpos] = joints
        qpos[self.gripper_qpos] = gripper * self.gripper_sign
        for name, T in layout.T_in_world.items():
            address = self.object_qpos[name]
            qpos[address : address + 3] = T[:3, 3]
            qpos[address + 3 : address + 7] = quat_from_rotation(T[:3, :3])
        return qpos

    def reset(self, data: mujoco.MjData, qpos: Array) -> None:
        """Reset `data` wholly and put everything at rest at `qpos` (nq,), every drive told to hold its place."""
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = qpos
        data.ctrl[self.arm_ctrl] = qpos[self.joint_qpos]
        data.ctrl[self.gripper_ctrl] = qpos[self.gripper_qpos[0]]
        mujoco.mj_forward(self.model, data)
