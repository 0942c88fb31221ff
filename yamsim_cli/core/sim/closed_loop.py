"""Step a scene tick by tick, by commands that are decided on the way."""

from __future__ import annotations

import mujoco
import numpy as np

from ..config.task import Success, Timing
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..types import Actions
from .rollout import attach

# Farther from the object's middle the hand does not get hold of it, m. The banana's ends are 0.09 m from its middle.
_MAGNET_REACH = 0.08


class ClosedLoop:
    """A scene in motion. What `rollout.simulate` makes of its `actions` from the same start is the same, bit for bit.

    Attributes:
        data: MuJoCo's state now; positions of bodies and sites are those of it.

    Args:
        start: MuJoCo's positions (nq,), everything at rest.
        carried: name of the object that the weld takes.
    """

    def __init__(self, scene: CompiledScene, start: Array, carried: str, timing: Timing) -> None:
        self._scene, self._carried, self._timing = scene, carried, timing
        self.data = mujoco.MjData(scene.model)
        scene.reset(self.data, start)
        self._ctrl: list[Array] = []
        self._magnet: list[bool] = []

    @property
    def ticks(self) -> int:
        """How many have passed."""
        return len(self._ctrl)

    @property
    def holds(self) -> bool:
        """Whether the weld holds the object."""
        return bool(self.data.eq_active[self._scene.arm.weld])

    @property
    def actions(self) -> Actions:
        """What has acted so far. There was no plan, so what it asked for is what the drives were told."""
        ctrl = np.array(self._ctrl)
        return Actions(ctrl, tuple(self._magnet), ctrl)

    def rests_on(self, target: str, limits: Success) -> bool:
        """Whether the object lies on a target by the task's limits now, at rest; who brought it there is not asked."""
        data, scene = self.data, self._scene
        dx, dy, dz = data.body(self._carried).xpos - data.body(target).xpos
        dof = scene.object_dof[self._carried]
        speed = float(np.linalg.norm(data.qvel[dof : dof + 3]))
        return bool(
            np.hypot(dx, dy) <= limits.threshold and 0.0 <= dz <= limits.max_height and speed <= limits.max_speed
        )

    def step(self, ctrl: Array, magnet: bool) -> None:
        """Let a command (nu,) act for one control tick; the weld takes the object only where the hand is at it."""
        scene, data = self._scene, self.data
        holds = magnet and (self.holds or self._within_reach())
        if holds and not self.holds:
            attach(scene.model, scene.arm, data, self._carried)
        data.eq_active[scene.arm.weld] = holds
        told = np.clip(ctrl, scene.model.actuator_ctrlrange[:, 0], scene.model.actuator_ctrlrange[:, 1])
        data.ctrl[:] = told
        self._ctrl.append(told)
        self._magnet.append(holds)
        mujoco.mj_step(scene.model, data, self._timing.physics_steps_per_tick)
        # mj_step leaves the poses of the step before.
        mujoco.mj_kinematics(scene.model, data)

    def _within_reach(self) -> bool:
        pinch, item = self.data.site("pinch_site").xpos, self.data.body(self._carried).xpos
        return float(np.linalg.norm(pinch - item)) <= _MAGNET_REACH
