from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..geometry.se3 import Array, invert_pose, pose, tilt_angle
from ..scene.compiled import CompiledScene
from ..sim.sim_world import SimWorld

SETTLED_TICKS = 8  # control ticks of holding after which an object counts as settled; fingers close until then


class HeldObjectSlipMonitor:
    """Keeps the largest `slip` (m) of settled objects in hands, and `tilt` (rad) of held objects since their grasps."""

    def __init__(self, scene: CompiledScene, world: SimWorld) -> None:
        self._scene, self._world = scene, world
        self._ticks: dict[tuple[str, int], int] = {}
        self._position_in_hand: dict[tuple[str, int], Array] = {}
        self._T_when_grasped: dict[str, Array] = {}
        self.slip = self.tilt = 0.0

    def measure_tick(self, holding_sides_by_object: Mapping[str, frozenset[str]]) -> None:
        """Measure the state after a control tick."""
        for name, holders in holding_sides_by_object.items():
            if name in self._scene.cloths:
                continue
            for k, side in enumerate(self._world.sides):
                if side in holders:
                    self._measure_held_object(name, k)
                else:
                    self._ticks.pop((name, k), None)
            if not holders:
                self._T_when_grasped.pop(name, None)

    def _measure_held_object(self, name: str, arm: int) -> None:
        key = (name, arm)
        ticks = self._ticks[key] = self._ticks.get(key, 0) + 1
        T = self._world.pose(name)
        self.tilt = max(self.tilt, tilt_angle(self._T_when_grasped.setdefault(name, T)[:3, :3].T @ T[:3, :3]))
        flange = self._world.data.body(self._scene.arms[arm].flange)
        position = (invert_pose(pose(flange.xpos, flange.xmat.reshape(3, 3))) @ T)[:3, 3]
        if ticks <= SETTLED_TICKS:
            self._position_in_hand[key] = position
        self.slip = max(self.slip, float(np.linalg.norm(position - self._position_in_hand[key])))
