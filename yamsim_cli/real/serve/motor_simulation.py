"""Simulate arms that emulated motors drive by their last commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compilation import physics_failure
from yamsim_cli.core.scene.compiled import ArmAddresses, CompiledScene, FingerAddresses

from ..motors.can_config import CanConfig, GripperCanConfig
from ..motors.motor import Motor
from ..motors.motor_bus import MotorBus

_STUCK_GRIPPER_ARMATURE = 1e9  # kg, armature that no motor can move
_IMPRATIO = 10.0  # MuJoCo's option; above 1, objects held by friction alone slip less
_CHECK_STEPS = 50


@dataclass(frozen=True)
class _Transmission:
    """Transmission from joint to motor shaft: `angle = ratio * joint + offset`.

    Attributes:
        drive: index of MuJoCo's actuator.
        qpos, dof: addresses of the joint, or of a gripper's left finger.
        gravity_scale: share of the links' weight on the motor; 0 for grippers, whose fingers are balanced.
    """

    arm: int
    motor: Motor
    drive: int
    qpos: int
    dof: int
    ratio: float
    offset: float
    gravity_scale: float


class MotorSimulation:
    """Simulates a scene whose arms and grippers are driven by motors on a bus per arm.

    Attributes:
        data: MuJoCo's current state.
        steps: physics steps so far.
        timestep: s.

    Args:
        scene: its model is changed: motors control the drives, and arms have their weight.
        start: positions (nq,), at rest; beyond a limit, a joint starts at the limit.
        can_configs, buses: of each arm, in the scene's order, motors in the config's.
    """

    def __init__(
        self, scene: CompiledScene, start: Array, can_configs: Sequence[CanConfig], buses: Sequence[MotorBus]
    ) -> None:
        self._model = model = scene.model
        self.data = mujoco.MjData(model)
        self.buses = tuple(buses)
        self.steps = 0
        self.timestep = float(model.opt.timestep)
        model.opt.impratio = _IMPRATIO
        self._fingers = [arm.fingers for arm in scene.arms]
        self._shafts = [
            shaft
            for k, (arm, wiring, bus) in enumerate(zip(scene.arms, can_configs, buses, strict=True))
            for shaft in _arm_transmissions(k, arm, wiring, bus)
        ]
        for arm, wiring in zip(scene.arms, can_configs, strict=True):
            if arm.fingers is not None and wiring.gripper is not None:
                _set_gripper_motor(model, arm.fingers, wiring.gripper)
        self._armature = model.dof_armature.copy()
        self._qpos, self._dof, self._drive = (
            np.array([getattr(shaft, key) for shaft in self._shafts]) for key in ("qpos", "dof", "drive")
        )
        self._ratio, self._offset, self._gravity_scale = (
            np.array([getattr(shaft, key) for shaft in self._shafts]) for key in ("ratio", "offset", "gravity_scale")
        )
        self._weight_factors = _weight_factors(model, scene.arms, can_configs)
        model.actuator_gainprm[self._drive] = 0.0
        # Contact and limit stiffness depend on the changed armatures.
        mujoco.mj_setConst(model, self.data)
        self._stuck = [False] * len(self.buses)
        self._apply_control_laws()
        scene.reset(self.data, _clip_to_stops(model, start))
        for arm in scene.arms:
            _compensate_attachments(model, self.data, arm)
        self._update_motor_states()

    @property
    def sim_time(self) -> float:
        """Simulated time, s."""
        return self.steps * self.timestep

    def gravity_torques(self, arm: int) -> list[float]:
        """Return motor torques, N m, that hold an arm against gravity."""
        torques = self._gravity_scale * self.data.qfrc_gravcomp[self._dof] / self._ratio
        return [float(torque) for torque, shaft in zip(torques, self._shafts, strict=True) if shaft.arm == arm]

    def step(self) -> None:
        """Advance physics and motors by one timestep. Raises `SimulationError` if physics breaks down."""
        self._apply_control_laws()
        # The model's gravity compensation cancels the links' weight, which the motors have to carry here. So the weight
        # is applied again, times each joint's load from the CAN config. `qfrc_gravcomp` is that of the previous step.
        data = self.data
        data.qfrc_applied[:] = -self._weight_factors * data.qfrc_gravcomp
        mujoco.mj_step(self._model, data)
        self.steps += 1
        now = self.sim_time
        for k, bus in enumerate(self.buses):
            bus.advance_to(now)
            if bus.is_gripper_stuck is not self._stuck[k]:
                self._set_gripper_stuck(k, bus.is_gripper_stuck)
        self._update_motor_states()
        if self.steps % _CHECK_STEPS == 0 and (text := physics_failure(data)):
            raise SimulationError(f"physics broke down within {now:.3f} s: {text}")

    def _apply_control_laws(self) -> None:
        for shaft in self._shafts:
            if not shaft.motor.control_law_changed:
                continue
            shaft.motor.control_law_changed = False
            kp, kd, constant = shaft.motor.control_law()
            ratio, most = shaft.ratio, shaft.motor.max_torque * abs(shaft.ratio)
            # MuJoCo integrates the damping of an affine bias implicitly.
            law = ratio * (constant - kp * shaft.offset), -kp * ratio**2, -kd * ratio**2
            self._model.actuator_biasprm[shaft.drive, :3] = law
            self._model.actuator_forcerange[shaft.drive] = -most, most

    def _update_motor_states(self) -> None:
        data = self.data
        positions = (data.qpos[self._qpos] * self._ratio + self._offset).tolist()
        velocities = (data.qvel[self._dof] * self._ratio).tolist()
        torques = (data.actuator_force[self._drive] / self._ratio).tolist()
        for shaft, position, velocity, torque in zip(self._shafts, positions, velocities, torques, strict=True):
            motor = shaft.motor
            motor.position, motor.velocity, motor.torque = position, velocity, torque

    def _set_gripper_stuck(self, arm: int, stuck: bool) -> None:
        self._stuck[arm] = stuck
        if (fingers := self._fingers[arm]) is not None:
            self._model.dof_armature[fingers.dof] = _STUCK_GRIPPER_ARMATURE if stuck else self._armature[fingers.dof]
            self.data.qvel[fingers.dof] = 0.0


def _arm_transmissions(number: int, arm: ArmAddresses, can_config: CanConfig, bus: MotorBus) -> list[_Transmission]:
    motors = bus.motors
    found = [
        _Transmission(number, motor, int(drive), int(qpos), int(dof), float(row.direction), 0.0, row.load)
        for row, motor, drive, qpos, dof in zip(
            can_config.arm.motors, motors[: arm.dof], arm.arm_ctrl, arm.joint_qpos, arm.joint_dof, strict=True
        )
    ]
    if arm.fingers is not None and can_config.gripper is not None:
        left = int(arm.fingers.qpos[0]), int(arm.fingers.dof[0])
        turns = can_config.gripper.shaft_ratio * float(arm.fingers.sign[0])
        found.append(_Transmission(number, motors[-1], arm.fingers.ctrl, *left, turns, can_config.gripper.closed, 0.0))
    return found


def _compensate_attachments(model: mujoco.MjModel, data: mujoco.MjData, arm: ArmAddresses) -> None:
    """Cancel the weight of parts beyond the maker's model, such as a camera: a motor's `load` has it."""
    root = model.body_rootid[model.body(arm.flange).id]
    for body in np.flatnonzero((model.body_rootid == root) & (model.body_gravcomp == 0)):
        data.xfrc_applied[body, :3] = -model.opt.gravity * model.body_mass[body]


def _weight_factors(model: mujoco.MjModel, arms: Sequence[ArmAddresses], can_configs: Sequence[CanConfig]) -> Array:
    """Return the factor (nv,) by which the links' weight loads each degree of freedom."""
    factors = np.ones(model.nv)
    for arm, can_config in zip(arms, can_configs, strict=True):
        factors[arm.joint_dof] = [motor.load for motor in can_config.arm.motors]
    return factors


def _set_gripper_motor(model: mujoco.MjModel, fingers: FingerAddresses, can_config: GripperCanConfig) -> None:
    """Halve the motor's armature and friction between the fingers, and add a limit where they meet."""
    model.dof_armature[fingers.dof] = can_config.armature * can_config.shaft_ratio**2 / 2
    model.dof_frictionloss[fingers.dof] = can_config.friction * abs(can_config.shaft_ratio) / 2
    for dof, sign in zip(fingers.dof, fingers.sign, strict=True):
        joint = model.dof_jntid[dof]
        model.jnt_range[joint] = sorted((0.0, float(sign * max(model.jnt_range[joint] * sign))))
        # The rotor hits a mechanical stop: as stiff as the timestep allows.
        model.jnt_solref[joint] = 2 * model.opt.timestep, 1.0


def _clip_to_stops(model: mujoco.MjModel, qpos: Array) -> Array:
    inside = qpos.copy()
    for joint in np.flatnonzero(model.jnt_limited):
        address = model.jnt_qposadr[joint]
        inside[address] = np.clip(inside[address], *model.jnt_range[joint])
    return inside
