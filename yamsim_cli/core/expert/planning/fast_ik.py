from __future__ import annotations

import math

import mujoco
import numpy as np

from ...geometry.se3 import Array, invert_pose

_DAMPING = 1e-3 * np.eye(6)  # of a least-squares step
_MAX_STEP = 0.4  # rad, of a joint in a step
_MAX_STEPS = 40
_METRES_PER_RADIAN = 0.25  # m, distance that an error of 1 rad counts as

# m and rad, largest errors of a returned solution; `IkSolver` refines it
_MAX_POSITION_ERROR = 3e-3
_MAX_ROTATION_ERROR = math.radians(4.0)

_MIN_PROGRESS_RATIO = 0.97  # ratio of the error to the error two steps before, above which the search gives up


class FastIkSolver:
    """Rejects poses out of reach faster than `IkSolver`, less exactly, for arms without analytic inverse kinematics.

    The model is a `scene.arm_model.kinematic_model`, whose site `tool` is the held frame. Targets are given in `world`.
    """

    def __init__(self, model: mujoco.MjModel, T_base_in_world: Array) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._T_world_in_base = invert_pose(T_base_in_world)
        self._site = model.site("tool").id
        self._low, self._high = model.jnt_range.T
        self._jacobian, self._quat, self._turn = np.empty((6, model.nv)), np.empty(4), np.empty(3)

    def solve(self, T_tool_in_world: Array, start: Array) -> Array | None:
        """Return joints (dof,) that bring the held frame near a pose; None if none are found."""
        T, joints = self._T_world_in_base @ T_tool_in_world, np.clip(start, self._low, self._high)
        before = (math.inf, math.inf)
        for _ in range(_MAX_STEPS):
            error = self._update_pose_error(T, joints)
            away, turn = float(error[:3] @ error[:3]), float(error[3:] @ error[3:])
            size = math.sqrt(away + turn)
            if away < _MAX_POSITION_ERROR**2 and turn < (_MAX_ROTATION_ERROR * _METRES_PER_RADIAN) ** 2:
                return joints
            if size > _MIN_PROGRESS_RATIO * before[0]:
                return None
            before = before[1], size
            J = self._jacobian
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPING, error)
            longest = float(np.abs(step).max())
            joints = np.minimum(np.maximum(joints + step * min(1.0, _MAX_STEP / longest), self._low), self._high)
        return None

    def _update_pose_error(self, T: Array, joints: Array) -> Array:
        """Update the Jacobian, and return the pose error (6,) in the base: m, and rad times `_METRES_PER_RADIAN`."""
        model, data = self._model, self._data
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, self._jacobian[:3], self._jacobian[3:], self._site)
        self._jacobian[3:] *= _METRES_PER_RADIAN
        # MuJoCo's arithmetic is faster than `geometry.se3`, and an attempt checks thousands of poses.
        turned = T[:3, :3] @ data.site_xmat[self._site].reshape(3, 3).T
        mujoco.mju_mat2Quat(self._quat, turned.ravel())
        mujoco.mju_quat2Vel(self._turn, self._quat, 1.0)
        return np.concatenate([T[:3, 3] - data.site_xpos[self._site], _METRES_PER_RADIAN * self._turn])
