"""Forward kinematics of one bare arm."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..geometry.se3 import Array, pose


class ArmKinematics:
    """Where `grasp_site` is for given joints.

    Args:
        model: a bare arm (nq = 6), see `scene.robot.bare_arm`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        self._site = model.site("grasp_site").id

    def T_grasp_in_base(self, joints: ArrayLike) -> Array:
        """Pose (4, 4) of `grasp_site` in the arm's base, with the arm at `joints` (6,) in rad."""
        self._data.qpos[:] = np.asarray(joints, dtype=np.float64)
        mujoco.mj_kinematics(self._model, self._data)
        return pose(self._data.site_xpos[self._site], self._data.site_xmat[self._site].reshape(3, 3))
