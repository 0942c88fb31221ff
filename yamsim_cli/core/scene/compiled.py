"""A compiled scene, and where its parts lie in MuJoCo's arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, pose, quat_from_rotation, rotation_z
from ..types import Layout, Stand

Ids = NDArray[np.int_]


class Kind(IntEnum):
    """What a geom belongs to."""

    OTHER = 0
    ARM = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    TABLE = 4


# Which kinds of geoms must not touch: an arm, fingers included, and the table.
FORBIDDEN = np.zeros((len(Kind), len(Kind)), dtype=bool)
for _part in (Kind.ARM, Kind.LEFT_FINGER, Kind.RIGHT_FINGER):
    FORBIDDEN[_part, Kind.TABLE] = FORBIDDEN[Kind.TABLE, _part] = True


@dataclass(frozen=True)
class SceneFingers:
    """Where an arm's two fingers lie in MuJoCo's arrays, and what they can do.

    Attributes:
        qpos, dof: addresses (2,) of the left and the right finger in `qpos` and `qvel`.
        sign: whether each counts its opening up there (1) or down (-1), (2,).
        ctrl: the drive's place in `ctrl`.
        gain: of the drive, N/m; both fingers share its force.
        ctrl_range: of what the drive can be told (2,), m.
        stops: of one finger's opening (2,), m.
        stroke: how far one finger opens in use, m.
        pads: whether they can hold an object by friction.
    """

    qpos: Ids
    dof: Ids
    sign: Array
    ctrl: int
    gain: float
    ctrl_range: Array
    stops: tuple[float, float]
    stroke: float
    pads: bool


@dataclass(frozen=True)
class SceneArm:
    """Where one arm's parts lie in MuJoCo's arrays, and what it can do.

    Attributes:
        number: of the arm, in its rig.
        prefix: before every name of the arm's.
        flange: name of the body that turns with the last joint.
        joint_qpos, joint_dof: addresses (dof,) of the arm's joints in `qpos` and `qvel`.
        arm_ctrl: the places (dof,) of the joints' drives in `ctrl`.
        kp, kv: gains (dof,) of these drives, N m/rad and N m s/rad.
        ctrl_range: (dof, 2) of these drives, rad.
        weld: id of the equality by which its hand holds the object; None where friction alone does.
        T_base_in_world: pose (4, 4) of the arm's base.
        joint_range, motor_speed, most_torque: of the joints (dof, 2) in rad, (dof,) in rad/s and (dof,) in N m.
        fingers: None of an arm without any.
        gravity: by how many times the joints' weight their gravity compensation gives too much (dof,); None where it is
            exact.
        offset: what is read of each joint where it is at 0 (dof,), rad, or 0 of all of them.
        sensors: ids of what reads the joints and the left finger late (drives,); None where they are read at once.
        command_delay, sensor_delay: how late commands act, and how old readings are, s.
        sensor_noise, encoder_step: standard deviation of what a joint reads, and the step in which it is read, rad.
    """

    number: int
    prefix: str
    flange: str
    joint_qpos: Ids
    joint_dof: Ids
    arm_ctrl: Ids
    kp: Array
    kv: Array
    ctrl_range: Array
    weld: int | None
    T_base_in_world: Array
    joint_range: Array
    motor_speed: Array
    most_torque: Array
    fingers: SceneFingers | None
    gravity: Array | None = None
    offset: Array | float = 0.0
    sensors: Ids | None = None
    command_delay: float = 0.0
    sensor_delay: float = 0.0
    sensor_noise: float = 0.0
    encoder_step: float = 0.0

    @property
    def reads_exactly(self) -> bool:
        """Whether what is read of it is where it is, or was."""
        return not (self.sensor_noise or self.encoder_step or np.any(self.offset))

    @property
    def dof(self) -> int:
        """How many joints the arm has, fingers not counted."""
        return len(self.joint_qpos)

    @property
    def drives(self) -> Ids:
        """Where its drives are in `ctrl`, as recordings have them: the joints', then the gripper's if it has one."""
        return self.arm_ctrl if self.fingers is None else np.append(self.arm_ctrl, self.fingers.ctrl)

    @property
    def recorded_qpos(self) -> Ids:
        """Where its joints are in `qpos`, as recordings have them, then the left finger's opening if there is one."""
        return self.joint_qpos if self.fingers is None else np.append(self.joint_qpos, self.fingers.qpos[0])

    @property
    def recorded_dof(self) -> Ids:
        """The same in `qvel`."""
        return self.joint_dof if self.fingers is None else np.append(self.joint_dof, self.fingers.dof[0])


@dataclass(frozen=True)
class SceneCloth:
    """Where a cloth's points lie in MuJoCo's arrays. They are in rows along its x axis.

    Attributes:
        flex: its number among MuJoCo's deformable things.
        grid: how many points lie along x and along y.
        rest: where the points (n, 3) lie in its own frame when it is flat, and in `world` where `qpos` is 0, m.
        qpos, dof: addresses (n, 3) in `qpos` and `qvel`.
        grips: ids (arms, n) of the equalities by which each hand can hold each point.
        radius: half its thickness, m.
        spacing: the larger of the distances between neighbours, m.
        by_layers: whether hands hold it by layers, see `Cloth.held`.
    """

    flex: int
    grid: tuple[int, int]
    rest: Array
    qpos: Ids
    dof: Ids
    grips: Ids
    radius: float
    spacing: float
    by_layers: bool

    @property
    def thickness(self) -> float:
        """How far apart two layers lie that lie on each other, m."""
        return 2 * self.radius

    def placed(self, qpos: Array, T_in_world: Array) -> None:
        """Lay it flat at a pose (4, 4), in MuJoCo's positions (nq,)."""
        qpos[self.qpos] = self.rest @ T_in_world[:3, :3].T + T_in_world[:3, 3] - self.rest

    def points(self, qpos: Array) -> Array:
        """Where its points (n, 3) are in `world` at MuJoCo's positions (nq,), m."""
        found: Array = self.rest + qpos[self.qpos]
        return found

    def pose(self, qpos: Array) -> Array:
        """An upright frame (4, 4) in `world`: in the middle of its points, turned as these are on the whole."""
        points = self.points(qpos)
        middle = points.mean(axis=0)
        shared = self.rest[:, :2].T @ (points - middle)[:, :2]
        turn = math.atan2(shared[0, 1] - shared[1, 0], shared[0, 0] + shared[1, 1])
        return pose(middle, rotation_z(turn))


@dataclass(frozen=True)
class CompiledScene:
    """A model with the addresses that stepping and recording need.

    Attributes:
        model: the compiled MuJoCo model; treat as constant outside an attempt (the welds' targets are written into it).
        arms: all of them, in the order in which recordings hold them: the left one first.
        object_qpos: stiff object's name -> address of its free joint in `qpos`.
        object_dof: stiff object's name -> address of its free joint in `qvel`.
        cameras: names of the cameras to record, in order.
        geom_kind: `Kind` of every geom (ngeom,).
        geom_arm: number in `arms` of the arm that a geom belongs to, -1 for none (ngeom,).
        cloths: cloth's name -> where its points are.
    """

    model: mujoco.MjModel
    arms: tuple[SceneArm, ...]
    object_qpos: Mapping[str, int]
    object_dof: Mapping[str, int]
    cameras: tuple[str, ...]
    geom_kind: Ids
    geom_arm: Ids
    cloths: Mapping[str, SceneCloth] = field(default_factory=dict)

    @property
    def arm(self) -> SceneArm:
        """The first arm: the only one, or the left one of two."""
        return self.arms[0]

    @property
    def things(self) -> tuple[str, ...]:
        """Names of all objects, cloths last."""
        return (*self.object_qpos, *self.cloths)

    @property
    def drives(self) -> Ids:
        """Where each arm's drives (arms, drives) are in `ctrl`: its joints', then its gripper's if it has one."""
        return np.array([arm.drives for arm in self.arms])

    @property
    def T_base_in_world(self) -> Array:
        """Pose (4, 4) of the base that recorded poses are in: the only arm's, or the left one's."""
        return self.arms[0].T_base_in_world

    def forbidden(self, geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which of some pairs of geoms (n, 2) must not touch (n,): arms and what lies on the table, or two arms."""
        kinds, arms = self.geom_kind[geoms], self.geom_arm[geoms]
        two_arms = (arms[:, 0] != arms[:, 1]) & (arms >= 0).all(axis=1)
        found: NDArray[np.bool_] = FORBIDDEN[kinds[:, 0], kinds[:, 1]] | two_arms
        # Cloth has no geoms, and says -1: everything may touch it.
        return found & (geoms >= 0).all(axis=1) if self.cloths else found

    def start_qpos(self, layout: Layout, stands: Sequence[Stand]) -> Array:
        """MuJoCo's positions (nq,) with the arms and their fingers where they stand, and the objects placed."""
        qpos: Array = self.model.qpos0.copy()
        for arm, stand in zip(self.arms, stands, strict=True):
            qpos[arm.joint_qpos] = stand.joints
            if arm.fingers is not None:
                qpos[arm.fingers.qpos] = stand.opening * arm.fingers.sign
        for name, T in layout.T_in_world.items():
            self.put(qpos, name, T)
        return qpos

    def put(self, qpos: Array, name: str, T_in_world: Array) -> None:
        """Put an object at a pose (4, 4), in MuJoCo's positions (nq,); a cloth lies flat there."""
        if name in self.cloths:
            self.cloths[name].placed(qpos, T_in_world)
            return
        address = self.object_qpos[name]
        qpos[address : address + 3] = T_in_world[:3, 3]
        qpos[address + 3 : address + 7] = quat_from_rotation(T_in_world[:3, :3])

    def reset(self, data: mujoco.MjData, qpos: Array, told: Array | None = None) -> None:
        """Reset `data` wholly and put everything at rest at `qpos` (nq,), every drive told to hold its place.

        The result is the same bit for bit, however `data` was used before.

        Args:
            told: what drives have been told all along (nu,) where that is something else; it acts where they act late.
        """
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = qpos
        for arm in self.arms:
            data.ctrl[arm.drives] = qpos[arm.recorded_qpos]
        for drive in np.flatnonzero(self.model.actuator_history[:, 0]):
            _tell(self.model, data, int(drive), float((data.ctrl if told is None else told)[drive]))
        for arm in self.arms:
            if arm.sensors is not None:
                for sensor, place in zip(arm.sensors, data.qpos[arm.recorded_qpos], strict=True):
                    _see(self.model, data, int(sensor), float(place))
        mujoco.mj_forward(self.model, data)

    def step(self, data: mujoco.MjData, steps: int = 1) -> None:
        """Let physics go on; all that steps a scene does it by this.

        MuJoCo's gravity compensation makes up for the links' weight. What an arm's own gives too much or too little is
        added before each step, from the state that it begins with: MuJoCo knows a factor of a body, and a joint's is
        none of these where several bodies hang on it.
        """
        errors = [(arm.joint_dof, arm.gravity) for arm in self.arms if arm.gravity is not None]
        if not errors:
            mujoco.mj_step(self.model, data, steps)
            return
        for _ in range(steps):
            for dof, gravity in errors:
                data.qfrc_applied[dof] = gravity * data.qfrc_gravcomp[dof]
            mujoco.mj_step(self.model, data)


def _tell(model: mujoco.MjModel, data: mujoco.MjData, drive: int, told: float) -> None:
    """Let a drive that acts late have been told this all along: MuJoCo begins with zeros."""
    times = _before(int(model.actuator_history[drive, 0]), model.opt.timestep)
    mujoco.mj_initCtrlHistory(model, data, drive, times, np.full(len(times), told))


def _see(model: mujoco.MjModel, data: mujoco.MjData, sensor: int, place: float) -> None:
    """Let a sensor that reads late have seen a joint there all along."""
    times = _before(int(model.sensor_history[sensor, 0]), model.opt.timestep)
    mujoco.mj_initSensorHistory(model, data, sensor, times, np.full((len(times), 1), place), 0.0)


def _before(samples: int, timestep: float) -> Array:
    """Times of as many steps before the beginning, s."""
    times: Array = np.arange(-samples, 0, dtype=np.float64) * timestep
    return times
