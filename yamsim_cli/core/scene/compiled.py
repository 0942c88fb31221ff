from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..attempt_data import ArmPosture, ObjectLayout
from ..geometry.se3 import Array, pose, pose_from_quat, quat_from_rotation, rotation_z
from .cloth import COMMON_BIT, LEAVING_BIT

Ids = NDArray[np.int_]


class GeomOwnerKind(IntEnum):
    """The kind of body to which a geom belongs."""

    OTHER = 0
    ARM = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    TABLE = 4


# [i, j]: whether geoms of kinds i and j must not touch, which are an arm or finger and the table.
FORBIDDEN_OWNER_PAIRS = np.zeros((len(GeomOwnerKind), len(GeomOwnerKind)), dtype=bool)
for _part in (GeomOwnerKind.ARM, GeomOwnerKind.LEFT_FINGER, GeomOwnerKind.RIGHT_FINGER):
    FORBIDDEN_OWNER_PAIRS[_part, GeomOwnerKind.TABLE] = FORBIDDEN_OWNER_PAIRS[GeomOwnerKind.TABLE, _part] = True


@dataclass(frozen=True)
class FingerAddresses:
    """The addresses and limits of an arm's two fingers.

    Attributes:
        qpos, dof: addresses (2,) of the left and the right finger in `qpos` and `qvel`.
        sign: of each finger's opening in `qpos` (2,).
        ctrl: address of the drive in `ctrl`.
        gain: position gain of the drive, N/m; both fingers share the force.
        ctrl_range: of the drive's commands (2,), m.
        opening_limits: mechanical limits of one finger's opening, m.
        full_opening: largest opening of one finger that commands use, m.
    """

    qpos: Ids
    dof: Ids
    sign: Array
    ctrl: int
    gain: float
    ctrl_range: Array
    opening_limits: tuple[float, float]
    full_opening: float


@dataclass(frozen=True)
class ArmAddresses:
    """The addresses and limits of one arm.

    Attributes:
        number: index of the arm in the rig.
        prefix: of all names of the arm.
        flange: the body that rotates with the last joint.
        joint_qpos, joint_dof: addresses (dof,) of the joints in `qpos` and `qvel`.
        arm_ctrl: addresses (dof,) of the joints' drives in `ctrl`.
        position_gain, velocity_gain: of these drives (dof,), N m/rad and N m s/rad.
        ctrl_range: of these drives (dof, 2), rad.
        weld: id of the weld by which the hand holds an object; None for grasps by friction.
        joint_range: joint limits (dof, 2), rad.
        motor_speed, max_torque: of the joints (dof,), rad/s and N m.
        gravity_error: error of each joint's gravity compensation (dof,), as a share of it; None if exact.
        encoder_offset: encoder reading of each joint at position 0 (dof,), rad, or 0 for all.
        sensors: ids of the delayed sensors of the joints and the left finger (drives,); None without delay.
        command_delay, sensor_delay: s.
        sensor_noise, encoder_step: standard deviation and resolution of joint readings, rad.
    """

    number: int
    prefix: str
    flange: str
    joint_qpos: Ids
    joint_dof: Ids
    arm_ctrl: Ids
    position_gain: Array
    velocity_gain: Array
    ctrl_range: Array
    weld: int | None
    T_base_in_world: Array
    joint_range: Array
    motor_speed: Array
    max_torque: Array
    fingers: FingerAddresses | None
    gravity_error: Array | None = None
    encoder_offset: Array | float = 0.0
    sensors: Ids | None = None
    command_delay: float = 0.0
    sensor_delay: float = 0.0
    sensor_noise: float = 0.0
    encoder_step: float = 0.0

    @property
    def has_ideal_encoders(self) -> bool:
        """Whether readings are exact except for their delay."""
        return not (self.sensor_noise or self.encoder_step or np.any(self.encoder_offset))

    @property
    def dof(self) -> int:
        """Joints, without fingers."""
        return len(self.joint_qpos)

    @property
    def drive_ctrl(self) -> Ids:
        """Addresses in `ctrl` of the joints' drives, then of the gripper's, if any."""
        return self.arm_ctrl if self.fingers is None else np.append(self.arm_ctrl, self.fingers.ctrl)

    @property
    def recorded_qpos(self) -> Ids:
        """Addresses in `qpos` of the joints, then of the left finger, if any."""
        return self.joint_qpos if self.fingers is None else np.append(self.joint_qpos, self.fingers.qpos[0])

    @property
    def recorded_dof(self) -> Ids:
        """Addresses in `qvel` of the joints, then of the left finger, if any."""
        return self.joint_dof if self.fingers is None else np.append(self.joint_dof, self.fingers.dof[0])


@dataclass(frozen=True)
class ClothAddresses:
    """The addresses of a cloth's points, ordered by rows along the cloth's x axis.

    Attributes:
        flex: id.
        grid: number of points along x and along y.
        flat_points: (n, 3) of the flat cloth in its frame, m; also in `world` at `qpos` 0.
        qpos, dof: addresses (n, 3) in `qpos` and `qvel`.
        constraints: ids (arms, n) of the equalities by which each hand can hold each point.
        half_thickness: m.
        max_point_spacing: larger of the distances between neighbouring points along x and along y, m.
        held_by_layers: whether a hand also grasps the nearest point of each layer between its pads.
        is_released_clear: whether fingers that released the cloth have no contacts with it until they leave it.
    """

    flex: int
    grid: tuple[int, int]
    flat_points: Array
    qpos: Ids
    dof: Ids
    constraints: Ids
    half_thickness: float
    max_point_spacing: float
    held_by_layers: bool
    is_released_clear: bool

    @property
    def thickness(self) -> float:
        """Distance between two layers, m."""
        return 2 * self.half_thickness

    def set_flat_pose(self, qpos: Array, T_in_world: Array) -> None:
        """Write the positions of the flat cloth at a pose into `qpos` (nq,)."""
        qpos[self.qpos] = self.flat_points @ T_in_world[:3, :3].T + T_in_world[:3, 3] - self.flat_points

    def points(self, qpos: Array) -> Array:
        """Return the points (n, 3) in `world` at `qpos` (nq,), m."""
        found: Array = self.flat_points + qpos[self.qpos]
        return found

    def pose(self, qpos: Array) -> Array:
        """Return the pose in `world` of an upright frame at the centroid of the points, with their mean yaw."""
        points = self.points(qpos)
        middle = points.mean(axis=0)
        shared = self.flat_points[:, :2].T @ (points - middle)[:, :2]
        turn = math.atan2(shared[0, 1] - shared[1, 0], shared[0, 0] + shared[1, 1])
        return pose(middle, rotation_z(turn))


@dataclass(frozen=True)
class ContainerRegion:
    """A box-shaped region of an object, such as a compartment of a tray, of `size` (3,), m.

    The region's origin is at the centre of the floor.
    """

    thing: str
    T_in_object: Array
    size: Array

    @property
    def corners(self) -> Array:
        """Lowest and highest corner (2, 3) in the region's frame, m."""
        x, y, z = self.size
        return np.array([[-x / 2, -y / 2, 0.0], [x / 2, y / 2, z]])


# Largest scaled gradient at the end of Newton's method, without unit. Of 88,000 steps of sorted cutlery, all but one
# ended with 0.16 or less. The other one had failed, and ended with 67.
_MAX_GRADIENT = 1.0
# MuJoCo's solver statistics have `mjNSOLVER` rows for each island, one for each iteration. This is the index before
# each island's first row: with the number of iterations added, it is the index of the last one. Without iterations,
# that row belongs to iteration 200 of another island, and is always 0, because scenes allow 100 iterations.
_ROW_BEFORE_ISLAND = np.arange(mujoco.mjNISLAND) * mujoco.mjNSOLVER - 1
_STEPPED_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class CompiledScene:
    """A compiled model with the addresses for stepping and recording.

    Attributes:
        model: constant between attempts, except that attempts write the targets of welds and of cloth constraints into
            it, and the contact masks of fingers that leave cloth.
        arms: in the order of recordings, the left one first.
        object_qpos, object_dof: rigid object -> address of its free joint in `qpos` and in `qvel`.
        cameras: names of the recorded cameras, in order.
        geom_kind: `GeomOwnerKind` of each geom (ngeom,).
        geom_arm: index of each geom's arm in `arms` (ngeom,), -1 for none.
        pieces: filled object -> ids of its pieces' free joints. `qpos0` has their first poses in the object's frame.
        regions: name -> region of an object.
    """

    model: mujoco.MjModel
    arms: tuple[ArmAddresses, ...]
    object_qpos: Mapping[str, int]
    object_dof: Mapping[str, int]
    cameras: tuple[str, ...]
    geom_kind: Ids
    geom_arm: Ids
    cloths: Mapping[str, ClothAddresses] = field(default_factory=dict)
    pieces: Mapping[str, Sequence[int]] = field(default_factory=dict)
    regions: Mapping[str, ContainerRegion] = field(default_factory=dict)

    @property
    def first_arm(self) -> ArmAddresses:
        """The only arm, or the left one of two."""
        return self.arms[0]

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of all objects, cloths last."""
        return (*self.object_qpos, *self.cloths)

    @functools.cached_property
    def recorded_drive_ctrl(self) -> Ids:
        """Addresses of each arm's recorded drives in `ctrl` (arms, drives)."""
        return np.array([arm.drive_ctrl for arm in self.arms])

    @property
    def T_base_in_world(self) -> Array:
        """Pose of the base of `first_arm`, in whose frame poses are recorded."""
        return self.arms[0].T_base_in_world

    def mask_forbidden_contacts(self, geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return whether each pair of geoms (n, 2) must not touch, as (n,): an arm and the table, or two arms."""
        found: NDArray[np.bool_] = self._forbidden_geom_pairs[geoms[:, 0], geoms[:, 1]]
        return found

    @functools.cached_property
    def _forbidden_geom_pairs(self) -> NDArray[np.bool_]:
        """Shape (ngeom + 1, ngeom + 1): the last row and column are for cloth, geom -1."""
        kinds, arms = self.geom_kind, self.geom_arm
        two_arms = (arms[:, None] != arms) & (arms[:, None] >= 0) & (arms >= 0)
        return np.pad(FORBIDDEN_OWNER_PAIRS[kinds[:, None], kinds] | two_arms, (0, 1))

    def start_qpos(self, layout: ObjectLayout, postures: Sequence[ArmPosture]) -> Array:
        """Return the `qpos` (nq,) with the arms and fingers in `postures` and the objects at `layout`."""
        qpos: Array = self.model.qpos0.copy()
        for arm, posture in zip(self.arms, postures, strict=True):
            qpos[arm.joint_qpos] = posture.joints
            if arm.fingers is not None:
                qpos[arm.fingers.qpos] = posture.opening * arm.fingers.sign
        for name, T in layout.T_in_world.items():
            self.set_object_pose(qpos, name, T)
        return qpos

    def set_object_pose(self, qpos: Array, name: str, T_in_world: Array) -> None:
        """Write an object's pose into `qpos` (nq,). A cloth lies flat; pieces get their first poses in the object."""
        if name in self.cloths:
            self.cloths[name].set_flat_pose(qpos, T_in_world)
            return
        address = self.object_qpos[name]
        qpos[address : address + 3] = T_in_world[:3, 3]
        qpos[address + 3 : address + 7] = quat_from_rotation(T_in_world[:3, :3])
        for k in self.model.jnt_qposadr[list(self.pieces.get(name, ()))]:
            T = T_in_world @ pose_from_quat(self.model.qpos0[k : k + 3], self.model.qpos0[k + 3 : k + 7])
            qpos[k : k + 7] = (*T[:3, 3], *quat_from_rotation(T[:3, :3]))

    @functools.cached_property
    def finger_geoms(self) -> tuple[tuple[Ids, Ids], ...]:
        """Ids of the geoms of the left and of the right finger of each arm."""

        def geoms_of(arm: int, kind: GeomOwnerKind) -> Ids:
            return np.flatnonzero((self.geom_arm == arm) & (self.geom_kind == kind))

        return tuple(
            (geoms_of(arm, GeomOwnerKind.LEFT_FINGER), geoms_of(arm, GeomOwnerKind.RIGHT_FINGER))
            for arm in range(len(self.arms))
        )

    @functools.cached_property
    def releases_clear(self) -> bool:
        """Whether any cloth has `is_released_clear`."""
        return any(cloth.is_released_clear for cloth in self.cloths.values())

    def switch_cloth_contacts(self, arm: int, on: bool) -> None:
        """Switch the contacts between the fingers of an arm and all cloth on or off; `reset` switches them on."""
        masks, geoms = self.model.geom_contype, np.concatenate(self.finger_geoms[arm])
        geoms = geoms[masks[geoms] != 0]
        masks[geoms] &= ~(COMMON_BIT | LEAVING_BIT)
        masks[geoms] |= COMMON_BIT if on else LEAVING_BIT

    def reset(self, data: mujoco.MjData, qpos: Array, commanded: Array | None = None) -> None:
        """Reset `data` to rest at `qpos` (nq,), with commands that hold each drive's position.

        The result is the same bit for bit, whatever `data` contained before. Delayed drives still execute the past
        commands `commanded` (nu,), by default the present positions.
        """
        mujoco.mj_resetData(self.model, data)
        if self.releases_clear:
            for number in range(len(self.arms)):
                self.switch_cloth_contacts(number, on=True)
        data.qpos[:] = qpos
        for arm in self.arms:
            data.ctrl[arm.drive_ctrl] = qpos[arm.recorded_qpos]
        for drive in np.flatnonzero(self.model.actuator_history[:, 0]):
            _fill_commands(self.model, data, int(drive), float((data.ctrl if commanded is None else commanded)[drive]))
        for arm in self.arms:
            if arm.sensors is not None:
                for sensor, position in zip(arm.sensors, data.qpos[arm.recorded_qpos], strict=True):
                    _fill_readings(self.model, data, int(sensor), float(position))
        mujoco.mj_forward(self.model, data)

    def step(self, data: mujoco.MjData, steps: int = 1) -> None:
        """Step physics. Use only this method to step a scene.

        It applies each joint's gravity compensation error: MuJoCo's own `gravcomp` is for a body, not for a
        joint.

        In rare cases, MuJoCo's Newton solver stops far from a solution, for example for a fork between two fingers and
        a tray, and the step gives speeds of up to 23,000 rad/s. Such a step is repeated without the last step's
        accelerations as the solver's start, and if that also fails, with the CG solver. After accelerations above 1e10,
        MuJoCo resets the state itself, see `physics_failure`.
        """
        for _ in range(steps):
            for dof, gravity in self.gravity_errors:
                data.qfrc_applied[dof] = gravity * data.qfrc_gravcomp[dof]
            mujoco.mj_getState(self.model, data, self._state_before_step, _STEPPED_STATE)
            mujoco.mj_step(self.model, data)
            if newton_failed(self.model, data):
                self._repeat_step(data)

    def _repeat_step(self, data: mujoco.MjData) -> None:
        """Repeat the last step from the state before it."""
        solver = self.model.opt.solver
        try:
            for next_solver in (solver, mujoco.mjtSolver.mjSOL_CG):
                mujoco.mj_setState(self.model, data, self._state_before_step, _STEPPED_STATE)
                data.qacc_warmstart[:] = 0.0
                self.model.opt.solver = next_solver
                mujoco.mj_step(self.model, data)
                if not newton_failed(self.model, data):
                    return
        finally:
            self.model.opt.solver = solver

    @functools.cached_property
    def _state_before_step(self) -> Array:
        return np.empty(mujoco.mj_stateSize(self.model, _STEPPED_STATE))

    @functools.cached_property
    def gravity_errors(self) -> list[tuple[Ids, Array]]:
        """Addresses in `qvel` of arms with gravity compensation errors, and their errors (dof,) as shares."""
        return [(arm.joint_dof, arm.gravity_error) for arm in self.arms if arm.gravity_error is not None]


def newton_failed(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether Newton's method stopped far from a solution in the last step, in one of the first 20 islands.

    It is always False for other solvers.
    """
    islands = min(data.nisland or 1, mujoco.mjNISLAND)
    last = _ROW_BEFORE_ISLAND[:islands] + data.solver_niter[:islands]
    far = data.solver.gradient[last].max() > _MAX_GRADIENT
    return bool(far) and model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON


def _fill_commands(model: mujoco.MjModel, data: mujoco.MjData, drive: int, command: float) -> None:
    """MuJoCo starts the history of a delayed drive with zeros: fill it with a command."""
    times = _history_times(int(model.actuator_history[drive, 0]), model.opt.timestep)
    mujoco.mj_initCtrlHistory(model, data, drive, times, np.full(len(times), command))


def _fill_readings(model: mujoco.MjModel, data: mujoco.MjData, sensor: int, position: float) -> None:
    times = _history_times(int(model.sensor_history[sensor, 0]), model.opt.timestep)
    mujoco.mj_initSensorHistory(model, data, sensor, times, np.full((len(times), 1), position), 0.0)


def _history_times(samples: int, timestep: float) -> Array:
    times: Array = np.arange(-samples, 0, dtype=np.float64) * timestep
    return times
