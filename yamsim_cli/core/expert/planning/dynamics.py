from __future__ import annotations

import mujoco
import numpy as np

from ...geometry.se3 import Array
from ...robots.robot import Robot
from ...scene.arm_model import finger_addresses


class ArmDynamics:
    """Inverse dynamics of a whole arm with its gripper, see `scene.arm_model.arm_spec`, for feed-forward commands."""

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        joints = [model.joint(name) for name in robot.joint_names]
        self._qpos, self._dof = (np.array([getattr(j, key)[0] for j in joints]) for key in ("qposadr", "dofadr"))
        self._fingers, self._signs = finger_addresses(model, robot)
        # Paths are planned without contacts; the controller handles their torques.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT

    def inverse_dynamics_torques(self, joints: Array, gripper: Array, tick: float) -> Array:
        """Return torques (n, dof), N m, at the middle of each tick (s): inertia, friction and uncompensated gravity.

        Joints (n + 1, dof), rad, are at the tick boundaries; `gripper` (n,) is the opening of each finger, m.
        """
        positions = (joints[1:] + joints[:-1]) / 2
        velocities = np.diff(joints, axis=0) / tick
        accelerations = np.gradient(velocities, tick, axis=0)
        torques = np.empty_like(positions)
        data = self._data
        mujoco.mj_resetData(self._model, data)
        qpos, qvel, qacc, found = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for k, opening in enumerate(gripper):
            qpos[self._qpos], qvel[self._dof], qacc[self._dof] = positions[k], velocities[k], accelerations[k]
            qpos[self._fingers] = opening * self._signs
            mujoco.mj_inverse(self._model, data)
            torques[k] = found[self._dof]
        return torques

    def payload_torques(self, joints: Array, point: Array, weight: float) -> Array:
        """Return the torques (n, dof), N m, that support a `weight` (N) at a `point` (3,) in the pinch frame, m."""
        data, site = self._data, self._model.site("pinch_site").id
        jacobian = np.empty((3, self._model.nv))
        torques = np.empty_like(joints)
        for k, row in enumerate(joints):
            data.qpos[self._qpos] = row
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            at = data.site_xpos[site] + data.site_xmat[site].reshape(3, 3) @ point
            mujoco.mj_jac(self._model, data, jacobian, None, at, self._model.site_bodyid[site])
            # The base stands upright in every rig, so its z axis is the world's.
            torques[k] = weight * jacobian[2, self._dof]
        return torques
