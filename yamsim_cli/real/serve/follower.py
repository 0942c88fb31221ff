"""Joint controller of a simulated arm, with the methods of the maker's SDK."""

from __future__ import annotations

from typing import Any

import numpy as np

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compiled import ArmAddresses

from ..motors.can_config import CanConfig
from ..motors.can_frames import KD_MAX, KP_MAX, MitCommand
from .motor_simulation import MotorSimulation

# N, of a finger. Source: `limit_gripper_force` in robots/get_robot.py of the maker's SDK 1.3.6.
_GRIP_FORCE = 50.0
# rad, of a command beyond a limit. Source: `get_robot.py` of the SDK, "safety buffer".
_LIMIT_TOLERANCE = 0.15


class JointController:
    """Controls arm `number`. Until its first command, other programs may drive the motors.

    Vectors (dofs,) have joints in rad, and last the gripper, 0 (closed) to 1 (open).

    Attributes:
        full_opening: opening of one finger at gripper value 1, m.
    """

    def __init__(self, plant: MotorSimulation, number: int, arm: ArmAddresses, can_config: CanConfig) -> None:
        self._plant, self._number, self._wiring = plant, number, can_config
        self._motors = plant.buses[number].motors
        hand = can_config.gripper
        turns = [float(row.direction) for row in can_config.arm.motors]
        self._ratio, self._offset = np.array(turns), np.zeros(len(turns))
        self._kp, self._kd = np.array(arm.position_gain), np.array(arm.velocity_gain)
        self._low, self._high = arm.joint_range[:, 0] - _LIMIT_TOLERANCE, arm.joint_range[:, 1] + _LIMIT_TOLERANCE
        self._grip_torque = 0.0
        self.full_opening = 1.0
        if hand is not None and arm.fingers is not None:
            # A gripper value of 1 is the fingers' joint limit, which the maker's SDK detects on the real arm.
            self.full_opening = float(max(arm.fingers.opening_limits))
            self._ratio = np.append(self._ratio, hand.shaft_ratio * self.full_opening)
            self._offset = np.append(self._offset, hand.closed)
            self._kp, self._kd = np.append(self._kp, hand.kp), np.append(self._kd, hand.kd)
            self._low, self._high = np.append(self._low, 0.0), np.append(self._high, 1.0)
            # N m: both fingers press with `_GRIP_FORCE`.
            self._grip_torque = 2 * _GRIP_FORCE / abs(hand.shaft_ratio) + hand.friction
        # Positions, velocities, gains kp and kd, each (dofs,).
        self._command: tuple[Array, Array, Array, Array] | None = None

    @property
    def commanded_joints(self) -> Array | None:
        """Commanded joints (dofs,), if any."""
        return None if self._command is None else self._command[0].copy()

    def num_dofs(self) -> int:
        """Return the number of joints and gripper."""
        return len(self._motors)

    def joint_pos(self) -> Array:
        """Return current joints (dofs,)."""
        angles = np.array([motor.position for motor in self._motors])
        position: Array = (angles - self._offset) / self._ratio
        return position

    def get_observations(self) -> dict[str, Array]:
        """Return positions, velocities and torques (N m) by the keys of the SDK's `get_observations`."""
        values = {
            "pos": self.joint_pos(),
            "vel": np.array([motor.velocity for motor in self._motors]) / self._ratio,
            "eff": np.array([motor.torque for motor in self._motors]) * np.sign(self._ratio),
        }
        joints = len(self._wiring.arm.motors)
        found = {f"joint_{key}": value[:joints] for key, value in values.items()}
        if self._wiring.gripper is not None:
            found |= {f"gripper_{key}": value[joints:] for key, value in values.items()}
        return found

    def command_joint_pos(self, joint_pos: Any) -> None:
        """Command joints (dofs,) with the arm's default gains.

        Raises:
            ValueError: the number of values is wrong, or a value is not finite.
        """
        position = self._finite_vector("joint_pos", joint_pos)
        self._command = position, np.zeros(len(position)), self._kp, self._kd

    def command_joint_state(self, joint_state: Any) -> None:
        """Command `pos` and `vel` (dofs,), with optional gains `kp` and `kd` (dofs,).

        Raises:
            ValueError: a key is missing, the number of values is wrong, or a value is not finite.
        """
        if not isinstance(joint_state, dict) or not {"pos", "vel"} <= joint_state.keys():
            raise ValueError("a joint state has pos and vel, and may have kp and kd")
        pos, vel = (self._finite_vector(key, joint_state[key]) for key in ("pos", "vel"))
        kp, kd = (
            np.clip(self._finite_vector(key, joint_state[key]), 0.0, most) if key in joint_state else own
            for key, most, own in (("kp", KP_MAX, self._kp), ("kd", KD_MAX, self._kd))
        )
        self._command = pos, vel, kp, kd

    def command_motors(self) -> None:
        """Send the last command and gravity torques to the motors."""
        if self._command is None:
            return
        position, velocity, kp, kd = self._command
        angles = np.clip(position, self._low, self._high) * self._ratio + self._offset
        if self._wiring.gripper is not None and kp[-1] > 0:
            # Limit kp's torque to the largest grip torque plus damping.
            motor = self._motors[-1]
            reach = (self._grip_torque + kd[-1] * abs(motor.velocity)) / kp[-1]
            angles[-1] = min(max(angles[-1], motor.position - reach), motor.position + reach)
        speeds = velocity * self._ratio
        for motor, *law in zip(
            self._motors, angles, speeds, kp, kd, self._plant.gravity_torques(self._number), strict=True
        ):
            motor.apply_command(MitCommand(*map(float, law)), self._plant.sim_time)

    def _finite_vector(self, what: str, given: Any) -> Array:
        try:
            values = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"{what}: not numbers") from None
        if values.shape != (len(self._motors),):
            raise ValueError(f"{what}: has shape {values.shape}; give {len(self._motors)} numbers, the gripper's last")
        if not np.isfinite(values).all():
            raise ValueError(f"{what}: has numbers that are not finite")
        return values
