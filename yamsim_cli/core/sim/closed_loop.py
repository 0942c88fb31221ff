"""Step a scene tick by tick, by commands that are decided on the way."""

from __future__ import annotations

import mujoco
import numpy as np

from ..config.task import Success, Timing
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..scene.robot import FINGER_JOINTS
from ..types import Actions, Holds
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
        self._magnet: list[Holds] = []

    @property
    def ticks(self) -> int:
        """How many have passed."""
        return len(self._ctrl)

    @property
    def holds(self) -> bool:
        """Whether a weld holds the object."""
        return any(self.held)

    @property
    def held(self) -> tuple[bool, ...]:
        """Whether each arm's weld holds it."""
        return tuple(self._held(arm) for arm in self._scene.arms)

    @property
    def joint_velocities(self) -> Array:
        """Of each arm's six joints in rad/s and of its finger's opening in m/s, (7,) or (14,), the left arm's first."""
        parts: list[Array] = []
        for arm in self._scene.arms:
            finger = self.data.joint(arm.prefix + FINGER_JOINTS[0])
            parts += [self.data.qvel[arm.joint_dof], finger.qvel]
        return np.concatenate(parts)

    @property
    def actions(self) -> Actions:
        """What has acted so far. There was no plan, so what it asked for is what the drives were told."""
        ctrl = np.array(self._ctrl)
        return Actions(ctrl, tuple(self._magnet), ctrl[:, self._scene.drives])

    def rests_on(self, target: str, limits: Success) -> bool:
        """Whether the object lies on a target by the task's limits now, at rest; who brought it there is not asked."""
        data, scene = self.data, self._scene
        dx, dy, dz = data.body(self._carried).xpos - data.body(target).xpos
        dof = scene.object_dof[self._carried]
        speed = float(np.linalg.norm(data.qvel[dof : dof + 3]))
        return bool(
            np.hypot(dx, dy) <= limits.threshold and 0.0 <= dz <= limits.max_height and speed <= limits.max_speed
        )

    def step(self, ctrl: Array, magnet: Holds) -> None:
        """Let a command act for one control tick; a weld takes the object only where its hand is at it.

        Args:
            ctrl: what the drives are told (7,) or (14,), the left arm's first, rad and m.
            magnet: whether the weld is to hold; of two arms, of each, or one word for both.
        """
        scene, data = self._scene, self.data
        asked = np.broadcast_to(magnet, len(scene.arms))
        holds = tuple(self._switch(arm, bool(on)) for arm, on in zip(scene.arms, asked, strict=True))
        told = np.empty(scene.model.nu)
        told[scene.drives] = ctrl
        told = np.clip(told, scene.model.actuator_ctrlrange[:, 0], scene.model.actuator_ctrlrange[:, 1])
        data.ctrl[:] = told
        self._ctrl.append(told)
        self._magnet.append(holds if len(holds) > 1 else holds[0])
        mujoco.mj_step(scene.model, data, self._timing.physics_steps_per_tick)
        # mj_step leaves the poses of the step before.
        mujoco.mj_kinematics(scene.model, data)

    def _held(self, arm: SceneArm) -> bool:
        return bool(self.data.eq_active[arm.weld])

    def _switch(self, arm: SceneArm, on: bool) -> bool:
        """Switch an arm's weld as far as its hand is near; whether it holds."""
        held = self._held(arm)
        holds = on and (held or self._within_reach(arm))
        if holds and not held:
            attach(self._scene.model, arm, self.data, self._carried)
        self.data.eq_active[arm.weld] = holds
        return holds

    def _within_reach(self, arm: SceneArm) -> bool:
        pinch, item = self.data.site(f"{arm.prefix}pinch_site").xpos, self.data.body(self._carried).xpos
        return float(np.linalg.norm(pinch - item)) <= _MAGNET_REACH
