"""A compiled scene, and the addresses of its parts in MuJoCo's arrays."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..attempt_data import ArmPosture, Layout
from ..geometry.se3 import Array, pose, quat_from_rotation, rotation_z

Ids = NDArray[np.int_]


class GeomOwner(IntEnum):
    """The kind of a geom's owner."""

    OTHER = 0
    ARM = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    TABLE = 4


# Pairs of kinds that must not touch: arms, with their fingers, and the table.
FORBIDDEN = np.zeros((len(GeomOwner), len(GeomOwner)), dtype=bool)
for _part in (GeomOwner.ARM, GeomOwner.LEFT_FINGER, GeomOwner.RIGHT_FINGER):
    FORBIDDEN[_part, GeomOwner.TABLE] = FORBIDDEN[GeomOwner.TABLE, _part] = True


@dataclass(frozen=True)
class FingerAddresses:
    """The addresses and limits of an arm's two fingers.

    Attributes:
        qpos, dof: addresses (2,) of the left and the right finger in `qpos` and `qvel`.
        sign: of each finger's opening in `qpos`, 1 or -1 (2,).
        ctrl: address of the drive in `ctrl`.
        gain: of the drive, N/m; both fingers share the force.
        ctrl_range: of the drive (2,), m.
        stops: of one finger's opening (2,), m.
        stroke: opening of one finger in use, m.
        pads: whether the fingers can hold an object by friction.
    """

    qpos: Ids
    dof: Ids
    sign: Array
    ctrl: int
    gain: float
    ctrl_range: Array
    opening_limits: tuple[float, float]
    stroke: float
    pads: bool


@dataclass(frozen=True)
class ArmAddresses:
    """The addresses and limits of one arm.

    Attributes:
        number: of the arm in the rig.
        prefix: of all names of the arm.
        flange: name of the body that turns with the last joint.
        joint_qpos, joint_dof: addresses (dof,) of the joints in `qpos` and `qvel`.
        arm_ctrl: addresses (dof,) of the joints' drives in `ctrl`.
        kp, kv: gains (dof,) of these drives, N m/rad and N m s/rad.
        ctrl_range: (dof, 2) of these drives, rad.
        weld: id of the equality by which the hand holds the object; None for grasps by friction.
        T_base_in_world: pose (4, 4) of the base.
        joint_range, motor_speed, most_torque: of the joints (dof, 2), rad; (dof,), rad/s; (dof,), N m.
        fingers: None of an arm without fingers.
        gravity: excess of the gravity compensation, as a factor of the joints' load (dof,); None if exact.
        offset: reading of each joint at 0 (dof,), rad, or 0 for all.
        sensors: ids of the delayed sensors of the joints and the left finger (drives,); None without delay.
        command_delay, sensor_delay: delay of commands, and age of readings, s.
        sensor_noise, encoder_step: standard deviation and resolution of a joint's reading, rad.
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
    max_torque: Array
    fingers: FingerAddresses | None
    gravity: Array | None = None
    offset: Array | float = 0.0
    sensors: Ids | None = None
    command_delay: float = 0.0
    sensor_delay: float = 0.0
    sensor_noise: float = 0.0
    encoder_step: float = 0.0

    @property
    def has_ideal_encoders(self) -> bool:
        """Whether readings are exact, apart from their delay."""
        return not (self.sensor_noise or self.encoder_step or np.any(self.offset))

    @property
    def dof(self) -> int:
        """The number of joints without fingers."""
        return len(self.joint_qpos)

    @property
    def drives(self) -> Ids:
        """Addresses of the recorded drives in `ctrl`: the joints', then the gripper's if there is one."""
        return self.arm_ctrl if self.fingers is None else np.append(self.arm_ctrl, self.fingers.ctrl)

    @property
    def recorded_qpos(self) -> Ids:
        """Addresses of the recorded joints in `qpos`, then of the left finger if there is one."""
        return self.joint_qpos if self.fingers is None else np.append(self.joint_qpos, self.fingers.qpos[0])

    @property
    def recorded_dof(self) -> Ids:
        """Addresses of the recorded joints in `qvel`, then of the left finger if there is one."""
        return self.joint_dof if self.fingers is None else np.append(self.joint_dof, self.fingers.dof[0])


@dataclass(frozen=True)
class ClothAddresses:
    """The addresses of a cloth's points, which are in rows along its x axis.

    Attributes:
        flex: id of the flex.
        grid: number of points along x and along y.
        rest: points (n, 3) of the flat cloth in its frame, and in `world` at a `qpos` of 0, m.
        qpos, dof: addresses (n, 3) in `qpos` and `qvel`.
        grips: ids (arms, n) of the equalities by which each hand can hold each point.
        radius: half the thickness, m.
        spacing: the larger of the distances between neighbouring points, m.
        by_layers: whether hands hold the cloth by layers, see `Cloth.held`.
    """

    flex: int
    grid: tuple[int, int]
    rest: Array
    qpos: Ids
    dof: Ids
    grips: Ids
    radius: float
    spacing: float
    held_by_layers: bool

    @property
    def thickness(self) -> float:
        """The distance between two layers, m."""
        return 2 * self.radius

    def put_flat(self, qpos: Array, T_in_world: Array) -> None:
        """Put the cloth flat at a pose (4, 4), in `qpos` (nq,)."""
        qpos[self.qpos] = self.rest @ T_in_world[:3, :3].T + T_in_world[:3, 3] - self.rest

    def points(self, qpos: Array) -> Array:
        """The points (n, 3) in `world` at `qpos` (nq,), m."""
        found: Array = self.rest + qpos[self.qpos]
        return found

    def pose(self, qpos: Array) -> Array:
        """An upright frame (4, 4) in `world` at the centroid of the points, with their mean rotation."""
        points = self.points(qpos)
        middle = points.mean(axis=0)
        shared = self.rest[:, :2].T @ (points - middle)[:, :2]
        turn = math.atan2(shared[0, 1] - shared[1, 0], shared[0, 0] + shared[1, 1])
        return pose(middle, rotation_z(turn))


@dataclass(frozen=True)
class CompiledScene:
    """A compiled model with the addresses that stepping and recording need.

    Attributes:
        model: constant outside an attempt; attempts write the welds' targets into the model.
        arms: in the order of recordings: the left one first.
        object_qpos, object_dof: stiff object's name -> address of its free joint in `qpos` and in `qvel`.
        cameras: names of the recorded cameras, in order.
        geom_kind: `Kind` of every geom (ngeom,).
        geom_arm: index of every geom's arm in `arms`, -1 for none (ngeom,).
        cloths: by name.
    """

    model: mujoco.MjModel
    arms: tuple[ArmAddresses, ...]
    object_qpos: Mapping[str, int]
    object_dof: Mapping[str, int]
    cameras: tuple[str, ...]
    geom_kind: Ids
    geom_arm: Ids
    cloths: Mapping[str, ClothAddresses] = field(default_factory=dict)

    @property
    def arm(self) -> ArmAddresses:
        """The first arm: the only one, or the left one of two."""
        return self.arms[0]

    @property
    def things(self) -> tuple[str, ...]:
        """Names of all objects, cloths last."""
        return (*self.object_qpos, *self.cloths)

    @functools.cached_property
    def drives(self) -> Ids:
        """Addresses of the recorded drives of each arm in `ctrl` (arms, drives)."""
        return np.array([arm.drives for arm in self.arms])

    @property
    def T_base_in_world(self) -> Array:
        """Pose (4, 4) of the base in whose frame poses are recorded: the only arm's, or the left one's."""
        return self.arms[0].T_base_in_world

    def forbidden(self, geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Whether each pair of geoms (n, 2) must not touch (n,): an arm and the table, or two arms."""
        found: NDArray[np.bool_] = self._forbidden[geoms[:, 0], geoms[:, 1]]
        return found

    @functools.cached_property
    def _forbidden(self) -> NDArray[np.bool_]:
        """Whether each geom must not touch each other geom; the last row and column are cloth, which has geom -1."""
        kinds, arms = self.geom_kind, self.geom_arm
        two_arms = (arms[:, None] != arms) & (arms[:, None] >= 0) & (arms >= 0)
        return np.pad(FORBIDDEN[kinds[:, None], kinds] | two_arms, (0, 1))

    def start_qpos(self, layout: Layout, postures: Sequence[ArmPosture]) -> Array:
        """The initial `qpos` (nq,) of the arms with their fingers, and of the objects."""
        qpos: Array = self.model.qpos0.copy()
        for arm, stand in zip(self.arms, postures, strict=True):
            qpos[arm.joint_qpos] = stand.joints
            if arm.fingers is not None:
                qpos[arm.fingers.qpos] = stand.opening * arm.fingers.sign
        for name, T in layout.T_in_world.items():
            self.put(qpos, name, T)
        return qpos

    def put(self, qpos: Array, name: str, T_in_world: Array) -> None:
        """Put an object at a pose (4, 4), in `qpos` (nq,); a cloth is flat."""
        if name in self.cloths:
            self.cloths[name].put_flat(qpos, T_in_world)
            return
        address = self.object_qpos[name]
        qpos[address : address + 3] = T_in_world[:3, 3]
        qpos[address + 3 : address + 7] = quat_from_rotation(T_in_world[:3, :3])

    def reset(self, data: mujoco.MjData, qpos: Array, commanded: Array | None = None) -> None:
        """Reset `data` to rest at `qpos` (nq,), with every drive commanded to hold its position.

        The result is the same bit for bit, however `data` was used before.

        Args:
            commanded: earlier commands of the drives (nu,), by default those positions; delayed drives follow them.
        """
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = qpos
        for arm in self.arms:
            data.ctrl[arm.drives] = qpos[arm.recorded_qpos]
        for drive in np.flatnonzero(self.model.actuator_history[:, 0]):
            _fill_commands(self.model, data, int(drive), float((data.ctrl if commanded is None else commanded)[drive]))
        for arm in self.arms:
            if arm.sensors is not None:
                for sensor, place in zip(arm.sensors, data.qpos[arm.recorded_qpos], strict=True):
                    _fill_readings(self.model, data, int(sensor), float(place))
        mujoco.mj_forward(self.model, data)

    def step(self, data: mujoco.MjData, steps: int = 1) -> None:
        """Step physics. Everything that steps a scene calls this method.

        The error of an arm's gravity compensation is applied before each step: MuJoCo only has factors of bodies, and
        several bodies load a joint.
        """
        if not self._gravity_errors:
            mujoco.mj_step(self.model, data, steps)
            return
        for _ in range(steps):
            for dof, gravity in self._gravity_errors:
                data.qfrc_applied[dof] = gravity * data.qfrc_gravcomp[dof]
            mujoco.mj_step(self.model, data)

    @functools.cached_property
    def _gravity_errors(self) -> list[tuple[Ids, Array]]:
        return [(arm.joint_dof, arm.gravity) for arm in self.arms if arm.gravity is not None]


def _fill_commands(model: mujoco.MjModel, data: mujoco.MjData, drive: int, command: float) -> None:
    """Fill the history of a delayed drive with a command: MuJoCo starts with zeros."""
    times = _history_times(int(model.actuator_history[drive, 0]), model.opt.timestep)
    mujoco.mj_initCtrlHistory(model, data, drive, times, np.full(len(times), command))


def _fill_readings(model: mujoco.MjModel, data: mujoco.MjData, sensor: int, place: float) -> None:
    """Fill the history of a delayed sensor with a joint position."""
    times = _history_times(int(model.sensor_history[sensor, 0]), model.opt.timestep)
    mujoco.mj_initSensorHistory(model, data, sensor, times, np.full((len(times), 1), place), 0.0)


def _history_times(samples: int, timestep: float) -> Array:
    """The times of a number of steps before the start, s."""
    times: Array = np.arange(-samples, 0, dtype=np.float64) * timestep
    return times
