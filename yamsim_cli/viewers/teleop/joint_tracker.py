from __future__ import annotations

import numpy as np

from yamsim_cli.core.geometry.se3 import Array

_MAX_SPEED_SHARE = 0.5  # of the motors' no-load speed; the rest overcomes load and friction
_MAX_ACCELERATION = 12.0  # rad/s^2, of each joint


class JointTracker:
    """The reference `joints` (dof,), rad, which follow a moving goal with bounded speed and acceleration, and stop on
    it.

    Args:
        motor_speed: no-load speed (dof,), rad/s.
        joint_range: joint limits (dof, 2), rad.
        tick: s.
    """

    def __init__(self, motor_speed: Array, joint_range: Array, tick: float) -> None:
        self._speed = _MAX_SPEED_SHARE * motor_speed
        self._low, self._high = joint_range.T
        self._tick = tick
        self.joints: Array = np.zeros_like(motor_speed)
        self._velocity: Array = np.zeros_like(motor_speed)

    def reset(self, joints: Array) -> None:
        """Set the reference to `joints` (dof,), rad, at rest."""
        self.joints, self._velocity = joints.copy(), np.zeros_like(joints)

    def next_reference(self, goal: Array) -> Array:
        """Return the reference (dof,) one tick later towards `goal` (dof,), without applying it."""
        distance = np.clip(goal, self._low, self._high) - self.joints
        # The speed from which braking ends at the goal, and the speed that reaches the goal in this tick.
        braking = np.sqrt(2 * _MAX_ACCELERATION * np.abs(distance))
        wanted = np.sign(distance) * np.minimum.reduce([self._speed, braking, np.abs(distance) / self._tick])
        most = _MAX_ACCELERATION * self._tick
        change: Array = np.clip(wanted - self._velocity, -most, most)
        reached: Array = np.clip(self.joints + (self._velocity + change) * self._tick, self._low, self._high)
        return reached

    def apply_reference(self, joints: Array) -> Array:
        """Set the reference to `joints` (dof,), and return the velocity (dof,) of this tick, rad/s."""
        self._velocity = (joints - self.joints) / self._tick
        self.joints = joints.copy()
        return self._velocity

    def halt(self) -> None:
        """Set the velocity to 0."""
        self._velocity = np.zeros_like(self._velocity)
