"""What the maker's SDK does on top of the motors, for programs that talk of joints: it holds an arm and drives it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry.se3 import Array
from ..motors.frames import KD_MAX, KP_MAX, Mit
from ..motors.wiring import Wiring
from ..scene.compiled import SceneArm
from .plant import Plant

# The most that fingers press with, N. Source: `limit_gripper_force` in robots/get_robot.py of the maker's SDK 1.3.6.
_GRIP_FORCE = 50.0
# A commanded joint may lie this far beyond a stop, rad. Source: the same file, "safety buffer".
_BEYOND = 0.15


class Follower:
    """Drives one arm of a plant, once it is told to: until then its motors are left to whoever else drives them.

    Joints are in rad, and the gripper, last, goes from 0, closed, to 1, wide open.

    Args:
        number: of the arm, in the plant.
    """

    def __init__(self, plant: Plant, number: int, arm: SceneArm, wiring: Wiring) -> None:
        self._plant, self._number, self._wiring = plant, number, wiring
        self._motors = plant.buses[number].motors
        hand = wiring.gripper
        turns = [float(row.direction) for row in wiring.arm.motors]
        self._ratio, self._offset = np.array(turns), np.zeros(len(turns))
        self._kp, self._kd = np.array(arm.kp), np.array(arm.kv)
        self._low, self._high = arm.joint_range[:, 0] - _BEYOND, arm.joint_range[:, 1] + _BEYOND
        self._grip_torque = 0.0
        if hand is not None and arm.fingers is not None:
            # Wide open is where their stop is, as the maker's SDK finds it.
            self._ratio = np.append(self._ratio, hand.ratio * max(arm.fingers.stops))
            self._offset = np.append(self._offset, hand.closed)
            self._kp, self._kd = np.append(self._kp, hand.kp), np.append(self._kd, hand.kd)
            self._low, self._high = np.append(self._low, 0.0), np.append(self._high, 1.0)
            # Both fingers press, each as far as it goes.
            self._grip_torque = 2 * _GRIP_FORCE / abs(hand.ratio) + hand.friction
        self._told: tuple[Array, Array, Array, Array] | None = None

    @property
    def told(self) -> Array | None:
        """Where the joints are told to be (dofs,); None before the first command."""
        return None if self._told is None else self._told[0].copy()

    def num_dofs(self) -> int:
        """How many joints there are, the gripper included."""
        return len(self._motors)

    def joint_pos(self) -> Array:
        """Where the joints are (dofs,)."""
        angles = np.array([motor.position for motor in self._motors])
        position: Array = (angles - self._offset) / self._ratio
        return position

    def observations(self) -> dict[str, Array]:
        """Positions, velocities and torques, of the joints and of the gripper, as the maker's `get_observations`."""
        values = {
            "pos": self.joint_pos(),
            "vel": np.array([motor.velocity for motor in self._motors]) / self._ratio,
            # Of the motors themselves, in the joints' sense of turning.
            "eff": np.array([motor.torque for motor in self._motors]) * np.sign(self._ratio),
        }
        joints = len(self._wiring.arm.motors)
        told = {f"joint_{key}": value[:joints] for key, value in values.items()}
        if self._wiring.gripper is not None:
            told |= {f"gripper_{key}": value[joints:] for key, value in values.items()}
        return told

    def command_joint_pos(self, joint_pos: Any) -> None:
        """Go to joints (dofs,), with the arm's own gains.

        Raises:
            ValueError: it is not as many finite numbers.
        """
        position = self._numbers("joint_pos", joint_pos)
        self._told = position, np.zeros(len(position)), self._kp, self._kd

    def command_joint_state(self, joint_state: Any) -> None:
        """Go to joints `pos` at velocities `vel`, (dofs,) each, by gains `kp` and `kd` where they are given.

        Raises:
            ValueError: something is missing, or is not as many finite numbers.
        """
        if not isinstance(joint_state, dict) or not {"pos", "vel"} <= joint_state.keys():
            raise ValueError("a joint state has pos and vel, and may have kp and kd")
        pos, vel = (self._numbers(key, joint_state[key]) for key in ("pos", "vel"))
        kp, kd = (
            np.clip(self._numbers(key, joint_state[key]), 0.0, most) if key in joint_state else own
            for key, most, own in (("kp", KP_MAX, self._kp), ("kd", KD_MAX, self._kd))
        )
        self._told = pos, vel, kp, kd

    def tick(self) -> None:
        """Tell the motors what to do until the next physics step."""
        if self._told is None:
            return
        position, velocity, kp, kd = self._told
        angles = np.clip(position, self._low, self._high) * self._ratio + self._offset
        if self._wiring.gripper is not None and kp[-1] > 0:
            # Never farther off than what makes the fingers press with their force, or go on at their speed.
            motor = self._motors[-1]
            reach = (self._grip_torque + kd[-1] * abs(motor.velocity)) / kp[-1]
            angles[-1] = min(max(angles[-1], motor.position - reach), motor.position + reach)
        speeds = velocity * self._ratio
        for motor, *told in zip(self._motors, angles, speeds, kp, kd, self._plant.held(self._number), strict=True):
            motor.drive(Mit(*map(float, told)), self._plant.now)

    def _numbers(self, what: str, given: Any) -> Array:
        try:
            values = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"{what}: not numbers") from None
        if values.shape != (len(self._motors),):
            raise ValueError(f"{what}: has shape {values.shape}; give {len(self._motors)} numbers, the gripper's last")
        if not np.isfinite(values).all():
            raise ValueError(f"{what}: has numbers that are not finite")
        return values
