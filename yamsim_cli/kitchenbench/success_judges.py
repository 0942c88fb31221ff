"""Judges of a scene's goal: KitchenBench's checker, or a yamsim task's own goal."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from kitchenbench.sim import make_success_checker

from ..core.episode.episode_rules import EndRule
from ..core.geometry.se3 import Array
from ..core.sim.geom_shapes import geom_aabb
from ..core.sim.sim_world import SimWorld
from .benchmark_scene import BenchmarkScene
from .lids import LID
from .scene_stepper import SceneStepper
from .yamsim_scene import YamsimTaskScene

_GRIPPER_PREFIX = "gripper_"  # before a side: that arm's two fingers in the checkers' queries


class Judge(Protocol):
    """Decides during an episode whether the goal is reached. `unrealized` has unfulfilled requirements as sentences."""

    instruction: str
    unrealized: tuple[str, ...]
    step_info: dict[str, Any]

    def evaluate(self) -> tuple[bool, str]:
        """Return whether the goal is reached now, and an explanation."""


class KitchenJudge:
    """Judges by KitchenBench's checker, which is called after each action. See `Judge` for attributes."""

    def __init__(self, realized: BenchmarkScene, motion: SceneStepper) -> None:
        self.instruction, self.unrealized = realized.blueprint.instruction, realized.unrealized
        self.step_info = {"contract_version": realized.blueprint.contract_version}
        self.world = KitchenWorld(realized, motion)
        self._checker = make_success_checker(realized.blueprint, self.world)

    def evaluate(self) -> tuple[bool, str]:
        """Return the checker's verdict and explanation."""
        verdict = self._checker(self.world)
        return bool(verdict.success), str(verdict.explanation)


class GoalJudge:
    """Judges by a task's own goal, evaluated after each control tick. See `Judge` for attributes."""

    def __init__(self, realized: YamsimTaskScene, motion: SceneStepper) -> None:
        self.instruction = realized.instruction
        self.unrealized: tuple[str, ...] = ()
        self.step_info: dict[str, Any] = {"end_rule": EndRule.SUCCESS.value}
        self._episode = motion.episode

    def evaluate(self) -> tuple[bool, str]:
        """Return whether the goal has held for its hold time, and its state as text."""
        return self._episode.has_succeeded, self._episode.goal_status


class KitchenWorld:
    """Answers the queries of KitchenBench's checkers about the present state of a scene.

    Names are those of the blueprint's objects, `gripper_left` and `gripper_right`. Lengths are in m, in `world`: x
    ahead of the arms, y to their left, z up.
    """

    def __init__(self, realization: BenchmarkScene, motion: SceneStepper) -> None:
        simulator = realization.simulator
        compiled = simulator.scene
        self._model, self._data = compiled.model, motion.data
        names = list(compiled.object_names)
        self._masses = {item.name: 1000 * item.inertia.mass for item in simulator.config.task.objects}
        self._filled = realization.substances
        self._lidded = {
            item.name for item in simulator.config.task.objects if any(link.name == LID for link in item.links)
        }
        self.scene: SimWorld = motion.episode.world
        self._names = {*names, *compiled.regions}
        self._grippers = {
            _GRIPPER_PREFIX + side: geoms[compiled.model.geom_contype[geoms] != 0]
            for side, geoms in zip(realization.sides, map(np.concatenate, compiled.finger_geoms), strict=True)
        }

    def aabb(self, name: str) -> tuple[Array, Array]:
        """Return the lowest and highest corner (3,) of an object's colliding geoms, or of a gripper's two fingers."""
        if name in self._grippers:
            corners = np.array([geom_aabb(self._model, self._data, int(geom)) for geom in self._grippers[name]])
            return corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        return self.scene.aabb(self._require_known(name))

    def contained_fraction(self, item: str, container: str) -> float:
        """Return the share, 0..1, of an item's volume in a container's bounding box, or in a compartment."""
        return self.scene.volume_fraction_in_box(self._require_known(item), self._require_known(container))

    def contained_mass_g(self, substance: str, container: str) -> float:
        """Return the mass in a container, g: of the pieces of a substance whose centres are in its interior.

        For any other object, return its mass times the share of its volume in the container's bounding box.
        """
        if substance in self._filled:
            return self.scene.grams_inside(self._filled[substance], self._require_known(container))
        if substance not in self._masses:
            raise KeyError(substance)
        return self._masses[substance] * self.contained_fraction(substance, container)

    def opening_fraction(self, name: str) -> float:
        """Return how far a container's lid is open, measured at its joint, 0 shut .. 1 off; 0 without such a lid."""
        known = self._require_known(name)
        if known not in self._lidded:
            return 0.0
        return float(np.clip(self.scene.joint_opening(known, LID), 0.0, 1.0))

    def _require_known(self, name: str) -> str:
        if name not in self._names:
            raise KeyError(name)
        return name
