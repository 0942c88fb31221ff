"""A quick answer to whether an arm without a closed solution reaches a pose: most are out of reach."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ..geometry.se3 import Array, inverse

# Damped least squares: the damping, the longest step of a joint, rad, and how many steps are made.
_DAMPED = 1e-3 * np.eye(6)
_STEP = 0.4
_STEPS = 40

# A radian counts as much as so many metres.
_LEVER = 0.25

# A pose this near to the wanted one is good enough to be finished by `IkSolver`, m and rad.
_POSITION = 3e-3
_ROTATION = math.radians(4.0)

# Where the error shrinks by less than this from one step to the next but one, it has come to its end.
_STALLED = 0.97


class QuickReach:
    """Inverse kinematics of the frame that a bare arm holds, without the care that `IkSolver` takes.

    Args:
        model: the bare arm, see `scene.robot.bare_arm`.
        T_base_in_world: pose (4, 4) of its base; targets are given in `world`.
    """

    def __init__(self, model: mujoco.MjModel, T_base_in_world: Array) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._T_world_in_base = inverse(T_base_in_world)
        self._site = model.site("tool").id
        self._low, self._high = model.jnt_range.T
        self._jacobian, self._quat, self._turn = np.empty((6, model.nv)), np.empty(4), np.empty(3)

    def solve(self, T_tool_in_world: Array, start: Array) -> Array | None:
        """Joints (dof,) near those that bring the held frame to a pose (4, 4); None where none were found."""
        T, joints = self._T_world_in_base @ T_tool_in_world, np.clip(start, self._low, self._high)
        before = (math.inf, math.inf)
        for _ in range(_STEPS):
            error = self._error(T, joints)
            away, turn = float(error[:3] @ error[:3]), float(error[3:] @ error[3:])
            size = math.sqrt(away + turn)
            if away < _POSITION**2 and turn < (_ROTATION * _LEVER) ** 2:
                return joints
            if size > _STALLED * before[0]:
                return None
            before = before[1], size
            J = self._jacobian
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPED, error)
            longest = float(np.abs(step).max())
            joints = np.minimum(np.maximum(joints + step * min(1.0, _STEP / longest), self._low), self._high)
        return None

    def _error(self, T: Array, joints: Array) -> Array:
        """What is left to the pose (6,), in the base's frame: m, and rad times the lever. It brings the Jacobian up to
        date.
        """
        model, data = self._model, self._data
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, self._jacobian[:3], self._jacobian[3:], self._site)
        self._jacobian[3:] *= _LEVER
        # Thousands of poses are looked at in an attempt, so this is MuJoCo's arithmetic rather than `geometry.se3`'s.
        turned = T[:3, :3] @ data.site_xmat[self._site].reshape(3, 3).T
        mujoco.mju_mat2Quat(self._quat, turned.ravel())
        mujoco.mju_quat2Vel(self._turn, self._quat, 1.0)
        return np.concatenate([T[:3, 3] - data.site_xpos[self._site], _LEVER * self._turn])
