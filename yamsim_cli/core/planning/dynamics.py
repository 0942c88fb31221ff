"""What it takes to move the arm along a path: inverse dynamics, for the drives to be told beforehand."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.robot import fingers


class ArmDynamics:
    """Joint torques of one arm from its motion.

    Args:
        model: the whole arm with its gripper, see `scene.robot.arm_spec`; its first six joints are the arm's.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        self._fingers, self._signs = fingers(model)
        # Nothing along a path is touched on purpose; what is, is for the controller to feel.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT

    def torques(self, joints: Array, gripper: Array, tick: float) -> Array:
        """Torques (n, 6) in N m in the middle of each tick, friction included, gravity as far as it is not compensated.

        Args:
            joints: positions (n + 1, 6) at the ticks' boundaries, rad.
            gripper: opening (n,) of one finger, m.
            tick: length of a tick, s.
        """
        positions = (joints[1:] + joints[:-1]) / 2
        velocities = np.diff(joints, axis=0) / tick
        accelerations = np.gradient(velocities, tick, axis=0)
        torques = np.empty_like(positions)
        data = self._data
        for k, opening in enumerate(gripper):
            mujoco.mj_resetData(self._model, data)
            data.qpos[:6], data.qvel[:6], data.qacc[:6] = positions[k], velocities[k], accelerations[k]
            data.qpos[self._fingers] = opening * self._signs
            mujoco.mj_inverse(self._model, data)
            torques[k] = data.qfrc_inverse[:6]
        return torques
