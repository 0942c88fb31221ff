"""Steps a scene tick by tick, by commands that are decided on the way."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ..config.program_task import ProgramTiming
from ..config.task import Success, Timing
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..types import Actions, EpisodeJob, Holds
from .cloth import ClothGrips
from .readings import readings, sensed
from .rollout import attach

# Largest distance of the hand from the object's middle at which the magnet takes it, m. The banana's ends are 0.09 m
# from its middle.
_MAGNET_REACH = 0.08


class ClosedLoop:
    """A scene in motion. `rollout.simulate` gives the same states, bit for bit, from the same start and its `actions`.

    Attributes:
        data: MuJoCo's present state, with bodies' and sites' positions up to date.

    Args:
        start: MuJoCo's positions (nq,), from which everything starts at rest.
        carried: name of the object that the weld takes; None where there are no welds.
    """

    def __init__(self, scene: CompiledScene, start: Array, carried: str | None, timing: Timing | ProgramTiming) -> None:
        self._scene, self._carried, self._timing = scene, carried, timing
        self.data = mujoco.MjData(scene.model)
        scene.reset(self.data, start)
        self._grips = ClothGrips(scene) if scene.cloths else None
        self._ctrl: list[Array] = []
        self._magnet: list[list[bool]] = []

    @property
    def ticks(self) -> int:
        """How many control ticks have passed."""
        return len(self._ctrl)

    @property
    def holds(self) -> bool:
        """Whether a weld holds the object."""
        return any(self.held)

    @property
    def held(self) -> tuple[bool, ...]:
        """Whether each arm's weld holds the object."""
        return tuple(self._held(arm) for arm in self._scene.arms)

    @property
    def joint_velocities(self) -> Array:
        """Of each arm's joints in rad/s, and of its finger's opening in m/s, (arms, drives)."""
        return np.array([self.data.qvel[arm.recorded_dof] for arm in self._scene.arms])

    def readings(self, job: EpisodeJob) -> Array:
        """What encoders read now of each arm's joints in rad and its finger's opening in m, (arms, drives)."""
        now = np.array([self.data.qpos[arm.recorded_qpos] for arm in self._scene.arms])
        seen = sensed(self._scene, self.data)
        return readings(self._scene, now if seen is None else seen, job, self.ticks)

    @property
    def actions(self) -> Actions:
        """All actions so far. Without a plan, the joints that it would ask for are what the drives were told."""
        ctrl = np.array(self._ctrl)
        return Actions(ctrl, np.array(self._magnet), ctrl[:, self._scene.drives])

    def rests_on(self, target: str, limits: Success) -> bool:
        """Whether the object lies at rest on a target now, by the task's limits, whoever brought it there."""
        data, scene = self.data, self._scene
        assert self._carried is not None, "asked of tasks with an object and a target"
        dx, dy, dz = data.body(self._carried).xpos - data.body(target).xpos
        dof = scene.object_dof[self._carried]
        speed = float(np.linalg.norm(data.qvel[dof : dof + 3]))
        return bool(
            np.hypot(dx, dy) <= limits.threshold and 0.0 <= dz <= limits.max_height and speed <= limits.max_speed
        )

    def step(self, ctrl: Array, magnet: Sequence[bool] | Holds) -> None:
        """Let a command act for one control tick; a weld takes the object only if its hand is near it.

        Args:
            ctrl: what each arm's drives are told (arms, drives), rad and m.
            magnet: whether each arm's weld is to hold (arms,).
        """
        scene, data = self._scene, self.data
        told = np.empty(scene.model.nu)
        told[scene.drives] = ctrl
        told = np.clip(told, scene.model.actuator_ctrlrange[:, 0], scene.model.actuator_ctrlrange[:, 1])
        if self._grips:
            holds = self._grips.update(data, told)
        else:
            holds = [self._switch(arm, bool(on)) for arm, on in zip(scene.arms, magnet, strict=True)]
        data.ctrl[:] = told
        self._ctrl.append(told)
        self._magnet.append(holds)
        scene.step(data, self._timing.physics_steps_per_tick)
        # After mj_step, poses are those of the step before.
        mujoco.mj_kinematics(scene.model, data)
        if self._grips:
            mujoco.mj_comPos(scene.model, data)
            mujoco.mj_flex(scene.model, data)
            mujoco.mj_collision(scene.model, data)

    def _held(self, arm: SceneArm) -> bool:
        return arm.weld is not None and bool(self.data.eq_active[arm.weld])

    def _switch(self, arm: SceneArm, on: bool) -> bool:
        """Whether an arm's weld holds after it was switched; switching it on takes the hand to be near the object."""
        if arm.weld is None or self._carried is None:
            return False
        held = self._held(arm)
        holds = on and (held or self._within_reach(arm, self._carried))
        if holds and not held:
            attach(self._scene.model, arm, self.data, self._carried)
        self.data.eq_active[arm.weld] = holds
        return holds

    def _within_reach(self, arm: SceneArm, carried: str) -> bool:
        pinch, item = self.data.site(f"{arm.prefix}pinch_site").xpos, self.data.body(carried).xpos
        return float(np.linalg.norm(pinch - item)) <= _MAGNET_REACH
