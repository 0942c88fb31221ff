"""What the hand would touch at a plan's waypoints, before anything moves."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, Kind
from ..types import Layout, Plan
from .ik import IkSolution

# How far the arm has to stay away from what it must not touch, m.
_DISTANCE = 0.003

_FINGERS = (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)


class Clearance:
    """Looks for contacts of an arm with table, target and other arms, and of its open fingers with the object that they
    are to close on.

    Args:
        arm: its number in the scene.
        stand: where the scene's arms stand otherwise (arms, 7): joints in rad, and the opening of one finger in m.
    """

    def __init__(self, scene: CompiledScene, arm: int = 0, stand: Array | None = None) -> None:
        self._scene = scene
        self._arm = arm
        self._stand = np.zeros((len(scene.arms), 7)) if stand is None else stand
        self._model = copy.copy(scene.model)
        self._model.geom_margin[scene.geom_arm >= 0] = _DISTANCE
        self._data = mujoco.MjData(self._model)

    def touched(
        self,
        plan: Plan,
        solutions: Sequence[IkSolution],
        layout: Layout,
        stands: Sequence[Array] | None = None,
    ) -> str | None:
        """Names of a waypoint and of two geoms that come too near each other there; None if there are none.

        Args:
            stands: where the scene's arms stand otherwise at each waypoint, if not always at the same place.
        """
        opening = plan.waypoints[0].gripper
        for k, (waypoint, solution) in enumerate(zip(plan.waypoints, solutions, strict=True)):
            # On the way to a waypoint fingers are as wide as before it, or as at it.
            widest, opening = max(opening, waypoint.gripper), waypoint.gripper
            stand = self._stand if stands is None else stands[k]
            if found := self._touched(stand, solution.joints, widest, layout, takes=not plan.weld and k == plan.grasp):
                return f"{waypoint.name}: {found}"
        return None

    def _touched(self, elsewhere: Array, joints: Array, opening: float, layout: Layout, *, takes: bool) -> str | None:
        model, data = self._model, self._data
        stand = elsewhere.copy()
        stand[self._arm] = (*joints, opening)
        data.qpos[:] = self._scene.start_qpos(layout, stand[:, :6], stand[:, 6])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        geoms = data.contact.geom
        kinds = self._scene.geom_kind[geoms]
        near = self._scene.forbidden(geoms)
        if takes:
            near |= np.isin(kinds, _FINGERS).any(axis=1) & (kinds == Kind.OBJECT).any(axis=1)
        if not near.any():
            return None
        one, other = (model.geom(int(geom)).name for geom in geoms[near][0])
        return f"{one} and {other}"
