"""Physics of many episodes, stepped by `mujoco.batch` on several threads."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import mujoco
import numpy as np
from mujoco.batch import Batch

from .core.episode.episode import Episode
from .core.episode.simulator import Simulator
from .core.geometry.se3 import Array
from .core.scene.compiled import Ids

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION  # all that determines the next step


class BatchedPhysics:
    """The physics of the episodes that share a compiled scene.

    Each episode has its own model, into which grasps write, and its own MuJoCo state.

    Args:
        simulator: of the scene.
        count: number of environments.
        threads: that step physics; the results do not depend on it.
    """

    def __init__(self, simulator: Simulator, count: int, threads: int) -> None:
        self._steps = simulator.config.task.timing.physics_steps_per_tick
        model = simulator.scene.model
        self._batch = Batch(model, count, threads)
        self._models = [model] * count
        self._episodes: list[Episode | None] = [None] * count
        self._gravity_compensation = np.zeros((count, model.nv))

    def load(self, k: int, episode: Episode) -> None:
        """Give environment `k` an episode at its start."""
        self._episodes[k], self._models[k] = episode, episode.scene.model
        self._batch.warning[k] = 0
        self._gravity_compensation[k] = episode.data.qfrc_gravcomp

    def step(self, environments: Sequence[int]) -> None:
        """Step a control tick of environments whose episodes have begun one, and write the results to the episodes."""
        # Grasps change constraints in the models, and a batch does not notice changes of a model.
        self._batch.set_models(self._models)
        for k in environments:
            episode = self._episode(k)
            mujoco.mj_getState(episode.scene.model, episode.data, self._batch.state[k], _STATE)
        ids = np.array(environments)
        errors = [(k, *error) for k in environments for error in self._episode(k).scene.gravity_errors]
        if errors:
            self._step_with_gravity_errors(ids, errors)
        else:
            self._batch.step(ids, self._steps)
        for k in environments:
            episode = self._episode(k)
            mujoco.mj_setState(episode.scene.model, episode.data, self._batch.state[k], _STATE)
            if self._batch.warning[k].any():
                self._copy_warnings(k, episode.data)

    def _step_with_gravity_errors(self, ids: Ids, errors: Sequence[tuple[int, Ids, Array]]) -> None:
        """Step physics as `CompiledScene.step` does."""
        applied, computed = self._batch.bind("qfrc_applied"), self._batch.bind("qfrc_gravcomp")
        for _ in range(self._steps):
            for k, dof, gravity in errors:
                applied[k, dof] = gravity * self._gravity_compensation[k, dof]
            self._batch.step(ids)
            self._gravity_compensation[ids] = computed[ids]

    def _copy_warnings(self, k: int, data: mujoco.MjData) -> None:
        for kind, (last_info, number) in enumerate(self._batch.warning[k]):
            data.warning[kind].lastinfo, data.warning[kind].number = int(last_info), int(number)

    def _episode(self, k: int) -> Episode:
        found = self._episodes[k]
        assert found is not None, "an environment has an episode before it is stepped"
        return found


class BatchedPhysicsCache:
    """Makes the physics of each scene, and keeps it as long as the scene's simulator exists."""

    def __init__(self, count: int, threads: int) -> None:
        self._count, self._threads = count, threads
        self._made: WeakKeyDictionary[Simulator, BatchedPhysics] = WeakKeyDictionary()

    def get(self, simulator: Simulator) -> BatchedPhysics:
        """Return the physics of a simulator's scene."""
        if simulator not in self._made:
            self._made[simulator] = BatchedPhysics(simulator, self._count, self._threads)
        return self._made[simulator]

    def close(self) -> None:
        """Free all physics."""
        self._made.clear()
