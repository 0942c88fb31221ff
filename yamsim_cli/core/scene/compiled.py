"""A compiled scene, and where its parts lie in MuJoCo's arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, quat_from_rotation
from ..shown_meshes import Drawn
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


# Which kinds of geoms must not touch: an arm, fingers included, and what the object lies on or is to lie on.
FORBIDDEN = np.zeros((len(Kind), len(Kind)), dtype=bool)
for _part in (Kind.ARM, Kind.LEFT_FINGER, Kind.RIGHT_FINGER):
    for _thing in (Kind.TABLE, Kind.TARGET):
        FORBIDDEN[_part, _thing] = FORBIDDEN[_thing, _part] = True


@dataclass(frozen=True)
class SceneArm:
    """Where one arm's parts lie in MuJoCo's arrays, and what it can do.

    Attributes:
        number: of the arm, in its rig.
        prefix: before every name of the arm's.
        joint_qpos, joint_dof: addresses (6,) of the arm's joints in `qpos` and `qvel`.
        gripper_qpos, gripper_sign: addresses (2,) of the left and right finger in `qpos`, and whether each counts its
            opening up there (1) or down (-1).
        arm_ctrl, gripper_ctrl: the drives' places in `ctrl`.
        kp, kv: gains (6,) of the arm's drives, N m/rad and N m s/rad.
        ctrl_range: (6, 2) of the arm's drives, rad.
        weld: id of the equality by which its hand holds the object.
        T_base_in_world: pose (4, 4) of the arm's base.
        joint_range, motor_speed, most_torque: of the arm's joints (6, 2) in rad, (6,) in rad/s and (6,) in N m.
        grip_gain: of the gripper's drive, N/m; both fingers share its force.
        grip_range: of what that drive can be told (2,), m.
    """

    number: int
    prefix: str
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
    T_base_in_world: Array
    joint_range: Array
    motor_speed: Array
    most_torque: Array
    grip_gain: float
    grip_range: Array


@dataclass(frozen=True)
class CompiledScene:
    """A model with the addresses that stepping and recording need.

    Attributes:
        model: the compiled MuJoCo model; treat as constant outside an attempt (the welds' targets are written into it).
        arms: all of them, in the order in which recordings hold them: the left one first.
        object_qpos: object name -> address of its free joint in `qpos`.
        object_dof: object name -> address of its free joint in `qvel`.
        cameras: names of the cameras to record, in order.
        geom_kind: `Kind` of every geom (ngeom,).
        geom_arm: number in `arms` of the arm that a geom belongs to, -1 for none (ngeom,).
        drawn: asset set -> what is drawn of it, see `core.shown_meshes`.
    """

    model: mujoco.MjModel
    arms: tuple[SceneArm, ...]
    object_qpos: Mapping[str, int]
    object_dof: Mapping[str, int]
    cameras: tuple[str, ...]
    geom_kind: Ids
    geom_arm: Ids
    drawn: Drawn

    @property
    def arm(self) -> SceneArm:
        """The first arm: the only one, or the left one of two."""
        return self.arms[0]

    @property
    def drives(self) -> Ids:
        """Where the drives (nu,) are in `ctrl`, as recordings have them: each arm's six and gripper, the left first."""
        return np.concatenate([[*arm.arm_ctrl, arm.gripper_ctrl] for arm in self.arms])

    @property
    def T_base_in_world(self) -> Array:
        """Pose (4, 4) of the base that recorded poses are in: the only arm's, or the left one's."""
        return self.arms[0].T_base_in_world

    def forbidden(self, geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which of some pairs of geoms (n, 2) must not touch (n,): arms and what lies on the table, or two arms."""
        kinds, arms = self.geom_kind[geoms], self.geom_arm[geoms]
        two_arms = (arms[:, 0] != arms[:, 1]) & (arms >= 0).all(axis=1)
        found: NDArray[np.bool_] = FORBIDDEN[kinds[:, 0], kinds[:, 1]] | two_arms
        return found

    def start(self, data: mujoco.MjData, layout: Layout, joints: Array, gripper: Array | float) -> None:
        """Reset `data` wholly and put all in place: bit for bit the same however `data` was used before."""
        self.reset(data, self.start_qpos(layout, joints, gripper))

    def start_qpos(self, layout: Layout, joints: Array, gripper: Array | float) -> Array:
        """MuJoCo's positions (nq,) with the arms at `joints` and their fingers at `gripper`, and the objects placed.

        Args:
            joints: (arms, 6) in rad; or (6,) for every arm.
            gripper: opening of one finger (arms,) in m; or one number for every arm.
        """
        qpos: Array = self.model.qpos0.copy()
        openings = np.broadcast_to(gripper, len(self.arms))
        for arm, angles, opening in zip(self.arms, np.broadcast_to(joints, (len(self.arms), 6)), openings, strict=True):
            qpos[arm.joint_qpos] = angles
            qpos[arm.gripper_qpos] = opening * arm.gripper_sign
        for name, T in layout.T_in_world.items():
            address = self.object_qpos[name]
            qpos[address : address + 3] = T[:3, 3]
            qpos[address + 3 : address + 7] = quat_from_rotation(T[:3, :3])
        return qpos

    def reset(self, data: mujoco.MjData, qpos: Array) -> None:
        """Reset `data` wholly and put everything at rest at `qpos` (nq,), every drive told to hold its place."""
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = qpos
        for arm in self.arms:
            data.ctrl[arm.arm_ctrl] = qpos[arm.joint_qpos]
            data.ctrl[arm.gripper_ctrl] = qpos[arm.gripper_qpos[0]]
        mujoco.mj_forward(self.model, data)
