"""Joint references that go after a moving goal, no faster than the arm can follow."""

from __future__ import annotations

import numpy as np

from ..geometry.se3 import Array

# Of the motors' no-load speed: what is left has to overcome load and friction.
_SPEED_SHARE = 0.5
# How quickly a reference may speed up and slow down, rad/s^2.
_ACCELERATION = 12.0


class Pursuit:
    """A joint reference that follows a goal with bounded speed and acceleration, and stops on it.

    Attributes:
        joints: the reference now (6,), rad.

    Args:
        motor_speed: no-load speed (6,) of each joint's motor, rad/s.
        joint_range: (6, 2), rad.
        tick: length of a control tick, s.
    """

    def __init__(self, motor_speed: Array, joint_range: Array, tick: float) -> None:
        self._speed = _SPEED_SHARE * motor_speed
        self._low, self._high = joint_range.T
        self._tick = tick
        self.joints: Array = np.zeros(6)
        self._velocity: Array = np.zeros(6)

    def reset(self, joints: Array) -> None:
        """Be at rest at `joints` (6,)."""
        self.joints, self._velocity = joints.copy(), np.zeros(6)

    def towards(self, goal: Array) -> Array:
        """Where the reference would be one tick on (6,), within its range, on the way to `goal` (6,)."""
        distance = np.clip(goal, self._low, self._high) - self.joints
        # What still comes to rest on the goal, and what reaches it in this tick.
        braking = np.sqrt(2 * _ACCELERATION * np.abs(distance))
        wanted = np.sign(distance) * np.minimum.reduce([self._speed, braking, np.abs(distance) / self._tick])
        most = _ACCELERATION * self._tick
        change: Array = np.clip(wanted - self._velocity, -most, most)
        reached: Array = np.clip(self.joints + (self._velocity + change) * self._tick, self._low, self._high)
        return reached

    def go(self, joints: Array) -> Array:
        """Take a tick's step to `joints` (6,); returns the velocity (6,) that this means, rad/s."""
        self._velocity = (joints - self.joints) / self._tick
        self.joints = joints.copy()
        return self._velocity

    def halt(self) -> None:
        """Stand still."""
        self._velocity = np.zeros(6)
