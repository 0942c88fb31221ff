"""Finds what an arm would run into before it moves there."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene

# Overlaps of less than this count as touching, m.
_TOUCH = 5e-4


class Obstruction:
    """Finds what an arm would run into at other joints. The task's objects do not count, since they can be moved.

    Args:
        arm: the arm's number in the scene.
    """

    def __init__(self, scene: CompiledScene, arm: int) -> None:
        self._scene = scene
        self._joints = scene.arms[arm].joint_qpos
        model = scene.model
        self._data = mujoco.MjData(model)
        self._is_arm = scene.geom_arm == arm
        objects = [model.body(name).id for name in scene.object_qpos]
        self._is_object = np.isin(model.body_rootid[model.geom_bodyid], objects)

    def depth(self, qpos: Array, joints: Array) -> tuple[float, str]:
        """How deep the arm would be in something else or in itself, m, and in what; 0 and "" if it is free.

        Args:
            qpos: MuJoCo's positions (nq,) of everything else.
            joints: the arm's (dof,), rad.
        """
        data, model = self._data, self._scene.model
        data.qpos[:] = qpos
        data.qpos[self._joints] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        concerned = (
            self._is_arm[pairs].any(axis=1) & ~self._is_object[pairs].any(axis=1) & (data.contact.dist < -_TOUCH)
        )
        if not concerned.any():
            return 0.0, ""
        worst = int(np.argmin(np.where(concerned, data.contact.dist, np.inf)))
        return float(-data.contact.dist[worst]), self._name(pairs[worst])

    def _name(self, pair: Array) -> str:
        others = [int(geom) for geom in pair if not self._is_arm[geom]]
        return self._scene.model.geom(others[0]).name.replace("_", " ") if others else "the arm itself"
