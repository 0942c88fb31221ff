"""Simulated arms driven by emulated motors, each by the law that it was last commanded."""

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

_STUCK_MASS = 1e9  # kg, armature of stuck fingers: no motor moves them
_IMPRATIO = 10.0  # MuJoCo's impratio, as in scenes where friction alone holds things
_CHECK_STEPS = 50  # steps between two checks whether physics broke down


@dataclass(frozen=True)
class _Transmission:
    """How a motor's shaft turns with a joint: `angle = ratio * joint + offset`.

    Attributes:
        arm: number of the arm.
        drive: index of MuJoCo's actuator.
        qpos, dof: of the joint; of a gripper, the left finger's.
        gravity_scale: how many times the links' weight the motor holds; 0 of a gripper, whose fingers balance each other.
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
    """A scene in motion, with a bus of motors for each arm.

    Attributes:
        data: MuJoCo's present state.
        buses: of each of the scene's arms, in their order.
        steps: how many physics steps have passed.

    Args:
        scene: its model is changed: drives follow the motors, and arms have their real weight.
        start: MuJoCo's positions (nq,) at the beginning, at rest; a joint beyond a stop begins at the stop.
        wirings: of each arm, in the scene's order.
        buses: of each arm, with the motors that its wiring names, in the same order.
    """

    def __init__(
        self, scene: CompiledScene, start: Array, wirings: Sequence[CanConfig], buses: Sequence[MotorBus]
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
            for k, (arm, wiring, bus) in enumerate(zip(scene.arms, wirings, buses, strict=True))
            for shaft in _shafts(k, arm, wiring, bus)
        ]
        for arm, wiring in zip(scene.arms, wirings, strict=True):
            if arm.fingers is not None and wiring.gripper is not None:
                _set_gripper_motor(model, arm.fingers, wiring.gripper)
        self._armature = model.dof_armature.copy()
        self._qpos, self._dof, self._drive = (
            np.array([getattr(shaft, key) for shaft in self._shafts]) for key in ("qpos", "dof", "drive")
        )
        self._ratio, self._offset, self._load = (
            np.array([getattr(shaft, key) for shaft in self._shafts]) for key in ("ratio", "offset", "gravity_scale")
        )
        self._weights = _weights(model, self._shafts)
        model.actuator_gainprm[self._drive] = 0.0
        # The armatures have changed, and the stiffness of contacts and stops depends on them.
        mujoco.mj_setConst(model, self.data)
        self._stuck = [False] * len(self.buses)
        self._apply_control_laws()
        scene.reset(self.data, _within_stops(model, start))
        for arm in scene.arms:
            _compensate_attachments(model, self.data, arm)
        self._sense()

    @property
    def now(self) -> float:
        """Simulated time, s."""
        return self.steps * self.timestep

    def gravity_torques(self, arm: int) -> list[float]:
        """The torques of an arm's motors that hold the arm against its weight in its present posture, N m."""
        torques = self._load * self.data.qfrc_gravcomp[self._dof] / self._ratio
        return [float(torque) for torque, shaft in zip(torques, self._shafts, strict=True) if shaft.arm == arm]

    def step(self) -> None:
        """One step of physics.

        Raises:
            SimulationError: physics broke down.
        """
        self._apply_control_laws()
        # MuJoCo compensates the links' weight. The applied force takes that back, times the load of each joint. The
        # compensation is that of the step before, which began 2 ms ago.
        data = self.data
        data.qfrc_applied[:] = -self._weights * data.qfrc_gravcomp
        mujoco.mj_step(self._model, data)
        self.steps += 1
        now = self.now
        for k, bus in enumerate(self.buses):
            bus.advance_to(now)
            if bus.stuck is not self._stuck[k]:
                self._set_stuck(k, bus.stuck)
        self._sense()
        if self.steps % _CHECK_STEPS == 0 and (text := physics_failure(data)):
            raise SimulationError(f"physics broke down within {now:.3f} s: {text}")

    def _apply_control_laws(self) -> None:
        for shaft in self._shafts:
            if not shaft.motor.control_law_changed:
                continue
            shaft.motor.control_law_changed = False
            kp, kd, constant = shaft.motor.control_law()
            ratio, most = shaft.ratio, shaft.motor.max_torque * abs(shaft.ratio)
            # The law is affine in the joint's position and velocity, so MuJoCo integrates the damping implicitly.
            law = ratio * (constant - kp * shaft.offset), -kp * ratio**2, -kd * ratio**2
            self._model.actuator_biasprm[shaft.drive, :3] = law
            self._model.actuator_forcerange[shaft.drive] = -most, most

    def _sense(self) -> None:
        data = self.data
        positions = (data.qpos[self._qpos] * self._ratio + self._offset).tolist()
        velocities = (data.qvel[self._dof] * self._ratio).tolist()
        torques = (data.actuator_force[self._drive] / self._ratio).tolist()
        for shaft, position, velocity, torque in zip(self._shafts, positions, velocities, torques, strict=True):
            motor = shaft.motor
            motor.position, motor.velocity, motor.torque = position, velocity, torque

    def _set_stuck(self, arm: int, stuck: bool) -> None:
        self._stuck[arm] = stuck
        if (fingers := self._fingers[arm]) is not None:
            self._model.dof_armature[fingers.dof] = _STUCK_MASS if stuck else self._armature[fingers.dof]
            self.data.qvel[fingers.dof] = 0.0


def _shafts(number: int, arm: ArmAddresses, wiring: CanConfig, bus: MotorBus) -> list[_Transmission]:
    motors = bus.motors
    found = [
        _Transmission(number, motor, int(drive), int(qpos), int(dof), float(row.direction), 0.0, row.load)
        for row, motor, drive, qpos, dof in zip(
            wiring.arm.motors, motors[: arm.dof], arm.arm_ctrl, arm.joint_qpos, arm.joint_dof, strict=True
        )
    ]
    if arm.fingers is not None and wiring.gripper is not None:
        left = int(arm.fingers.qpos[0]), int(arm.fingers.dof[0])
        turns = wiring.gripper.ratio * float(arm.fingers.sign[0])
        found.append(_Transmission(number, motors[-1], arm.fingers.ctrl, *left, turns, wiring.gripper.closed, 0.0))
    return found


def _compensate_attachments(model: mujoco.MjModel, data: mujoco.MjData, arm: ArmAddresses) -> None:
    """Compensate the weight of parts on an arm that the maker's model lacks, such as a camera.

    The loads of the motors include that weight.
    """
    root = model.body_rootid[model.body(arm.flange).id]
    for body in np.flatnonzero((model.body_rootid == root) & (model.body_gravcomp == 0)):
        data.xfrc_applied[body, :3] = -model.opt.gravity * model.body_mass[body]


def _weights(model: mujoco.MjModel, shafts: Sequence[_Transmission]) -> Array:
    """How many times the links' weight acts on each degree of freedom (nv,)."""
    weights = np.ones(model.nv)
    for shaft in shafts:
        if shaft.gravity_scale:
            weights[shaft.dof] = shaft.gravity_scale
    return weights


def _set_gripper_motor(model: mujoco.MjModel, fingers: FingerAddresses, wiring: GripperCanConfig) -> None:
    """Give fingers the armature and friction of their motor, half each, and stops, one of them where they meet."""
    model.dof_armature[fingers.dof] = wiring.armature * wiring.ratio**2 / 2
    model.dof_frictionloss[fingers.dof] = wiring.friction * abs(wiring.ratio) / 2
    for dof, sign in zip(fingers.dof, fingers.sign, strict=True):
        joint = model.dof_jntid[dof]
        model.jnt_range[joint] = sorted((0.0, float(sign * max(model.jnt_range[joint] * sign))))
        # As stiff as the time step allows, since the rotor hits the stop.
        model.jnt_solref[joint] = 2 * model.opt.timestep, 1.0


def _within_stops(model: mujoco.MjModel, qpos: Array) -> Array:
    inside = qpos.copy()
    for joint in np.flatnonzero(model.jnt_limited):
        address = model.jnt_qposadr[joint]
        inside[address] = np.clip(inside[address], *model.jnt_range[joint])
    return inside
