"""Simulate one arm under recorded commands, with parameters that a fit varies."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from yamsim_cli.core.config.rig import ArmConfig
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.robots.dynamics import MeasuredArmDynamics
from yamsim_cli.core.scene.arm_model import arm_spec

TIMESTEP, FINE_TIMESTEP = 0.002, 0.0005  # s: of tasks, and one too short to bias a fit

_MIN_INERTIA = 2e-4  # kg m2, armature plus half the moved links' inertia
_RANDOM_POSES = 64  # random poses
_DEFAULT_FRICTION_SPEED = 0.005  # rad/s, prior mean of `PlantParameters.friction_velocity`
_GRAVITY_PERIOD = 0.01  # s between computations of gravity torques
_MIN_FRICTION, _MIN_FRICTION_SPEED = 1e-6, 1e-5  # N m and rad/s; keep the solver finite


@dataclass(frozen=True)
class PlantParameters:
    """Parameters of an arm's motion, per joint (dof,) except the delay.

    Attributes:
        delay: from a command until it acts, s.
        friction: Coulomb friction, N m.
        damping: added to the drive's, N m s/rad; may be negative.
        armature: motor inertia at the joint, kg m2.
        offset: measured position when the drive holds 0, rad.
        gravity: factor of gravity torque in the gravity compensation.
        friction_velocity: speed of full friction, rad/s. Real friction does not reverse immediately when a joint stops:
            with 0, a fit finds too little friction.
    """

    delay: float
    friction: Array
    damping: Array
    armature: Array
    offset: Array
    gravity: Array
    friction_velocity: Array


@dataclass(frozen=True)
class ArmLog:
    """An arm's commands and measurements.

    Attributes:
        times: (n,), s.
        commands, joints: (n, dof), rad; joints are NaN where not measured.
        openings: commanded, or else measured (n,), m.
    """

    name: str
    times: Array
    commands: Array
    joints: Array
    openings: Array | None

    @classmethod
    def from_motion(cls, motion: RecordedMotion, arm: ArmMotion) -> ArmLog:
        """Return the log of a motion's arm, which must have commands."""
        assert arm.commands is not None, "motions without commands are refused before"
        known = (one for one in (arm.commanded_openings, arm.openings) if one is not None and np.isfinite(one).any())
        openings = next(known, None)
        filled = None if openings is None else _forward_fill(openings[:, None])[:, 0]
        return cls(motion.name, motion.times, _forward_fill(arm.commands), arm.joints, filled)

    def slice_time(self, start: float, end: float) -> ArmLog:
        """Return the part between two times, s, which then starts at 0."""
        kept = (self.times >= start) & (self.times <= end)
        openings = None if self.openings is None else self.openings[kept]
        times = self.times[kept]
        return ArmLog(self.name, times - times[0], self.commands[kept], self.joints[kept], openings)

    @property
    def duration(self) -> float:
        """Time of the last sample."""
        return float(self.times[-1])


class ParametricArm:
    """An arm without contacts, whose parameters can be replaced.

    Attributes:
        values: of the unchanged model.
        kp, kv: drive gains (dof,), N m/rad and N m s/rad.
        max_torque: of the drives (dof,), N m.
    """

    def __init__(self, arm: ArmConfig, timestep: float = TIMESTEP) -> None:
        self.timestep = timestep
        spec = arm_spec(arm, None)
        spec.option.timestep = timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.robot = robot = arm.robot
        self.model = model = spec.compile()
        joints = [model.joint(name) for name in robot.joint_names]
        self.qpos = np.array([joint.qposadr[0] for joint in joints])
        self.dof = np.array([joint.dofadr[0] for joint in joints])
        self.drives = np.array([model.actuator(name).id for name in robot.joint_drives])
        self.kp, self.kv = model.actuator_gainprm[self.drives, 0].copy(), -model.actuator_biasprm[self.drives, 2]
        self.max_torque = model.actuator_forcerange[self.drives, 1].copy()
        self.fingers = [model.joint(name).qposadr[0] for name in (robot.fingers.joints if robot.fingers else ())]
        self._links = _link_inertias(model, self.qpos, self.dof, robot.joint_range)
        self.model_values = _model_parameters(model, self.dof, robot.joint_names, arm.dynamics)

    def task_model(self, values: PlantParameters) -> mujoco.MjModel:
        """Return the model with this friction, armature and damping, as tasks simulate it.

        `LogSimulation.simulate` applies delay, offsets and gravity factors.
        """
        model, drives = copy.copy(self.model), self.drives
        model.dof_frictionloss[self.dof] = values.friction
        model.dof_armature[self.dof] = values.armature
        model.dof_damping[self.dof] = np.maximum(values.damping, 0)
        model.actuator_biasprm[drives, 2] = -(self.kv + np.minimum(values.damping, 0))
        # Friction stiffness is derived from inertia.
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def fitted_model(self, values: PlantParameters) -> mujoco.MjModel:
        """Return `task_model` with armatures corrected for the timestep, and friction rising with speed."""
        model = self.task_model(values)
        # Damping at the end of a step would make a fit find too little inertia.
        taken = values.armature - (self.kv + values.damping) * self.timestep / 2
        model.dof_armature[self.dof] = np.maximum(taken, _MIN_INERTIA - self._links / 2)
        # MuJoCo's friction is -(a + b v) / r up to its full value: with b = 1 / timestep, a damping of b / r, which the
        # implicit step keeps stable.
        b = 1 / self.timestep
        r = b * np.maximum(values.friction_velocity, _MIN_FRICTION_SPEED) / np.maximum(values.friction, _MIN_FRICTION)
        impedance = 1 / (1 + r / model.dof_invweight0[self.dof])
        model.dof_solref[self.dof] = np.column_stack([np.full(len(r), -1.0), -b * impedance])
        model.dof_solimp[self.dof, :2] = impedance[:, None]
        return model

    def gravity_torques(self, joints: Array) -> Array:
        """Return gravity compensation torques (n, dof), N m, at joints (n, dof), rad."""
        data, found = mujoco.MjData(self.model), np.empty(joints.shape)
        for k, row in enumerate(joints):
            data.qpos[self.qpos] = row
            mujoco.mj_fwdPosition(self.model, data)
            mujoco.mj_passive(self.model, data)
            found[k] = data.qfrc_gravcomp[self.dof]
        return found


class LogSimulation:
    """Simulates an arm under one log's commands; `measured_mask` (n,) masks samples with measured joints."""

    def __init__(self, plant: ParametricArm, log: ArmLog) -> None:
        self.plant, self.log = plant, log
        self.measured_mask = np.isfinite(log.joints).all(axis=1)
        self._steps = int(np.ceil(log.duration / self.plant.timestep)) + 1
        self._grid = self.plant.timestep * np.arange(self._steps + 1)
        self._clipped = np.clip(log.commands, *plant.model.actuator_ctrlrange[plant.drives].T)
        held = self._clipped[:-1] * np.diff(log.times)[:, None]
        self._integral = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(held, axis=0)])
        measured = np.column_stack(
            [
                np.interp(self._grid[:-1], log.times[self.measured_mask], column[self.measured_mask])
                for column in log.joints.T
            ]
        )
        coarse = np.arange(0, self._steps, max(1, round(_GRAVITY_PERIOD / plant.timestep)))
        torques = plant.gravity_torques(measured[coarse])
        self._torques = np.column_stack([np.interp(np.arange(self._steps), coarse, column) for column in torques.T])
        self._data = mujoco.MjData(plant.model)

    def simulate(self, values: PlantParameters, *, plain: bool = False) -> Array:
        """Return simulated encoder readings (n, dof), rad; `plain` uses `task_model`, as tasks do."""
        plant, log = self.plant, self.log
        model = plant.task_model(values) if plain else plant.fitted_model(values)
        controls = np.zeros((1, self._steps, model.nu + model.nv))
        controls[0, :, plant.drives] = self._delayed_commands(
            values.delay - (self.plant.timestep / 2 if plain else 0)
        ).T
        controls[0, :, model.nu + plant.dof] = ((values.gravity - 1) * self._torques).T
        data = self._data
        mujoco.mj_resetData(model, data)
        data.qpos[plant.qpos] = log.joints[self.measured_mask][0] - values.offset
        self._hold_fingers(controls, data)
        whole = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
        state = np.empty(mujoco.mj_stateSize(model, whole))
        mujoco.mj_getState(model, data, state, whole)
        spec = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        states, _ = rollout.rollout(model, data, state[None], controls, control_spec=spec, skip_checks=False)
        positions = np.vstack([state[None], states[0]])[:, 1 + plant.qpos]
        read = np.column_stack([np.interp(log.times, self._grid, column) for column in positions.T])
        return read + values.offset

    def _delayed_commands(self, delay: float) -> Array:
        """Return mean commands (steps, dof), rad, per physics step, `delay` s late."""
        # A drive applies the command at a step's beginning, so the mean is centred there.
        when, log = self._grid - self.plant.timestep / 2 - delay, self.log
        columns = []
        for first, last, total in zip(self._clipped[0], self._clipped[-1], self._integral.T, strict=True):
            sums = np.interp(when, log.times, total)
            sums = np.where(when < 0, first * when, sums)
            sums = np.where(when > log.times[-1], total[-1] + last * (when - log.times[-1]), sums)
            columns.append(np.diff(sums) / self.plant.timestep)
        return np.column_stack(columns)

    def _hold_fingers(self, controls: Array, data: mujoco.MjData) -> None:
        robot, openings = self.plant.robot, self.log.openings
        if robot.fingers is None:
            return
        if openings is None:
            commands = np.full(self._steps, robot.fingers.range[0])
        else:
            commands = np.interp(self._grid[:-1], self.log.times, openings)
        controls[0, :, self.plant.model.actuator(robot.fingers.drive).id] = commands
        data.qpos[self.plant.fingers] = commands[0] * np.array(robot.finger_signs)


def _forward_fill(commands: Array) -> Array:
    """Replace NaN in commands (n, dof) by the last number before it, or else the first."""
    filled = commands.copy()
    for column in filled.T:
        known = np.flatnonzero(np.isfinite(column))
        column[:] = column[known[np.clip(np.searchsorted(known, np.arange(len(column)), side="right") - 1, 0, None)]]
    return filled


def _model_parameters(
    model: mujoco.MjModel, dof: Array, names: tuple[str, ...], dynamics: MeasuredArmDynamics | None
) -> PlantParameters:
    joints = [dynamics.joint(name) if dynamics else None for name in names]
    return PlantParameters(
        delay=(dynamics.command_delay_ms + dynamics.sensor_delay_ms) / 1000 if dynamics else 0.0,
        friction=model.dof_frictionloss[dof].copy(),
        damping=model.dof_damping[dof].copy(),
        armature=model.dof_armature[dof].copy(),
        offset=np.array([joint.offset_rad if joint else 0.0 for joint in joints]),
        gravity=np.array([joint.gravity_factor if joint else 1.0 for joint in joints]),
        friction_velocity=np.full(len(names), _DEFAULT_FRICTION_SPEED),
    )


def _link_inertias(model: mujoco.MjModel, qpos: Array, dof: Array, ranges: Array) -> Array:
    """Return the links' least inertia (dof,), kg m2, in random poses, other joints free."""
    data, full = mujoco.MjData(model), np.empty((model.nv, model.nv))
    rng = np.random.default_rng(0)
    least = np.full(len(dof), np.inf)
    for _ in range(_RANDOM_POSES):
        data.qpos[qpos] = rng.uniform(*ranges.T)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        least = np.minimum(least, 1 / np.diag(np.linalg.inv(full))[dof])
    found: Array = np.maximum(least - model.dof_armature[dof], 0.0)
    return found
