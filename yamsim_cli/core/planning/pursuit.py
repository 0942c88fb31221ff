"""Joint references that pursue a moving goal, no faster than the arm can follow."""

from __future__ import annotations

import numpy as np

from ..geometry.se3 import Array

# Largest speed of a reference, as a share of the motors' no-load speed; the rest has to overcome load and friction.
_SPEED_SHARE = 0.5
# Largest acceleration of a reference, rad/s^2.
_ACCELERATION = 12.0


class Pursuit:
    """A joint reference that follows a goal with bounded speed and acceleration, and stops on it.

    Attributes:
        joints: the reference now (dof,), rad.

    Args:
        motor_speed: no-load speed (dof,) of each joint's motor, rad/s.
        joint_range: (dof, 2), rad.
        tick: length of a control tick, s.
    """

    def __init__(self, motor_speed: Array, joint_range: Array, tick: float) -> None:
        self._speed = _SPEED_SHARE * motor_speed
        self._low, self._high = joint_range.T
        self._tick = tick
        self.joints: Array = np.zeros_like(motor_speed)
        self._velocity: Array = np.zeros_like(motor_speed)

    def reset(self, joints: Array) -> None:
        """Be at rest at `joints` (dof,)."""
        self.joints, self._velocity = joints.copy(), np.zeros_like(joints)

    def towards(self, goal: Array) -> Array:
        """Where the reference would be one tick on (dof,), within its range, on the way to `goal` (dof,)."""
        distance = np.clip(goal, self._low, self._high) - self.joints
        # The speed from which it can still stop at the goal. Another bound is the speed that reaches it in this tick.
        braking = np.sqrt(2 * _ACCELERATION * np.abs(distance))
        wanted = np.sign(distance) * np.minimum.reduce([self._speed, braking, np.abs(distance) / self._tick])
        most = _ACCELERATION * self._tick
        change: Array = np.clip(wanted - self._velocity, -most, most)
        reached: Array = np.clip(self.joints + (self._velocity + change) * self._tick, self._low, self._high)
        return reached

    def go(self, joints: Array) -> Array:
        """Take a tick's step to `joints` (dof,); returns the velocity (dof,) that this means, rad/s."""
        self._velocity = (joints - self.joints) / self._tick
        self.joints = joints.copy()
        return self._velocity

    def halt(self) -> None:
        """Stand still."""
        self._velocity = np.zeros_like(self._velocity)
