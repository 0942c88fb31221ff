"""What the hand would touch at a plan's waypoints, before anything moves."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import FORBIDDEN, CompiledScene, Kind
from ..types import Layout, Plan
from .ik import IkSolution

# How far the arm has to stay away from what it must not touch, m.
_DISTANCE = 0.003

_FINGERS = (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)


class Clearance:
    """Looks for contacts of the arm with table and target, and of open fingers with the object they are to close on."""

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        self._model = copy.copy(scene.model)
        on_arm = np.isin(scene.geom_kind, (Kind.ARM, *_FINGERS))
        self._model.geom_margin[on_arm] = _DISTANCE
        self._data = mujoco.MjData(self._model)

    def touched(self, plan: Plan, solutions: Sequence[IkSolution], layout: Layout) -> str | None:
        """Names of a waypoint and of two geoms that come too near each other there; None if there are none."""
        opening = plan.waypoints[0].gripper
        for k, (waypoint, solution) in enumerate(zip(plan.waypoints, solutions, strict=True)):
            # On the way to a waypoint fingers are as wide as before it, or as at it.
            widest, opening = max(opening, waypoint.gripper), waypoint.gripper
            if found := self._touched(solution.joints, widest, layout, takes=not plan.weld and k == plan.grasp):
                return f"{waypoint.name}: {found}"
        return None

    def _touched(self, joints: Array, opening: float, layout: Layout, *, takes: bool) -> str | None:
        model, data = self._model, self._data
        data.qpos[:] = self._scene.start_qpos(layout, joints, opening)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        geoms = data.contact.geom
        kinds = self._scene.geom_kind[geoms]
        near = FORBIDDEN[kinds[:, 0], kinds[:, 1]]
        if takes:
            near |= np.isin(kinds, _FINGERS).any(axis=1) & (kinds == Kind.OBJECT).any(axis=1)
        if not near.any():
            return None
        one, other = (model.geom(int(geom)).name for geom in geoms[near][0])
        return f"{one} and {other}"
