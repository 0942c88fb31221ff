"""Finds what an arm would touch at a plan's waypoints, before anything moves."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from ..scene.compiled import CompiledScene, Kind
from ..types import Layout, Plan, Stand
from .ik import IkSolution

# Smallest distance of the arm from what it must not touch, m.
_DISTANCE = 0.003

_FINGERS = (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)


class Clearance:
    """Finds contacts of an arm with table, target and other arms, and of its open fingers with the object.

    Args:
        arm: its number in the scene.
        stands: where the scene's arms stand otherwise.
    """

    def __init__(self, scene: CompiledScene, arm: int, stands: Sequence[Stand]) -> None:
        self._scene = scene
        self._arm = arm
        self._stands = tuple(stands)
        self._model = copy.copy(scene.model)
        self._model.geom_margin[scene.geom_arm >= 0] = _DISTANCE
        self._data = mujoco.MjData(self._model)

    def touched(
        self,
        plan: Plan,
        solutions: Sequence[IkSolution],
        layout: Layout,
        elsewhere: Sequence[Sequence[Stand]] | None = None,
    ) -> str | None:
        """Names of a waypoint, and of two geoms that come too near each other there; None if there are none.

        Args:
            elsewhere: where the scene's arms stand otherwise at each waypoint, if not always at the same place.
        """
        opening = plan.waypoints[0].gripper
        for k, (waypoint, solution) in enumerate(zip(plan.waypoints, solutions, strict=True)):
            # On the way to a waypoint, the fingers' opening is between that at the one before and that at this one.
            widest, opening = max(opening, waypoint.gripper), waypoint.gripper
            stands = list(self._stands if elsewhere is None else elsewhere[k])
            stands[self._arm] = Stand(solution.joints, widest)
            if found := self._touched(stands, layout, takes=not plan.weld and k == plan.grasp):
                return f"{waypoint.name}: {found}"
        return None

    def _touched(self, stands: Sequence[Stand], layout: Layout, *, takes: bool) -> str | None:
        model, data = self._model, self._data
        data.qpos[:] = self._scene.start_qpos(layout, stands)
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
