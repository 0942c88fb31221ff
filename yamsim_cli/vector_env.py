"""Many environments of one task, for `gymnasium.make_vec`. Physics runs in `mujoco.batch` on several threads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_empty_array
from numpy.typing import NDArray

from .cpu_limits import usable_cores
from .gym_options import METADATA, TaskOptions

if TYPE_CHECKING:
    from .core.images.image import Image
    from .gym_physics import BatchedPhysics
    from .gym_task import StepResult
    from .policies.evaluate.stepped_task import RunningTrial

_Observations = dict[str, NDArray[Any]]
_Infos = dict[str, Any]


@dataclass
class _Environment:
    """An environment's trial, and the batch that has its physics."""

    trial: RunningTrial
    physics: BatchedPhysics
    is_over: bool = False


class PickPlaceVectorEnv(VectorEnv[_Observations, NDArray[np.float32], NDArray[Any]]):
    """Environments as `PickPlaceEnv`, stepped together: `gymnasium.make_vec("yamsim/PickPlace-v0", num_envs=64)`.

    Observations, rewards, ends and infos are the same as in gymnasium's `SyncVectorEnv` with the same environments, bit
    for bit, with any number of threads. The same engine judges each environment's episode.

    `reset(seed=S)` starts trial 0 of seed S + k in environment k; `seed` may be a sequence, with a seed or None for
    each environment. `options` has `trial`, the number of the trial in all environments, and `reset_mask`, an array
    (num_envs,) that is True for each environment to reset; by default all.

    Args:
        threads: threads of physics; by default one for each usable core. With images, this is also the number of
            processes that render, if above 1.
        autoreset_mode: of gymnasium. "NextStep", the default: the step after an episode's end ignores the action and
            starts the next trial. "SameStep": the same step starts the next trial, and `infos` has `final_obs` and
            `final_info`. "Disabled": the caller resets by `reset_mask`.
        render_mode, options: as in `PickPlaceEnv`.
    """

    metadata: ClassVar[dict[str, Any]] = METADATA  # type: ignore[misc]

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        *,
        threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs {num_envs} is not valid: give at least 1")
        if threads is not None and threads < 1:
            raise ValueError(f"threads {threads} is not valid: give at least 1")
        given = TaskOptions(render_mode=render_mode, **options)
        self._autoreset = AutoresetMode(autoreset_mode)
        session = given.open_session()
        # MuJoCo is imported after the choice of an OpenGL backend.
        from .core.episode.episode_rules import EndRule
        from .gym_physics import BatchedPhysicsCache
        from .gym_pictures import Pictures
        from .gym_task import GymTask
        from .policies.evaluate.stepped_task import SteppedTask

        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = METADATA | {"autoreset_mode": self._autoreset}  # type: ignore[misc]
        self._task = SteppedTask(session, EndRule(given.end), given.max_ticks, parallel_trials=num_envs)
        self._shared = GymTask(self._task.config, given, self._task.simulator.scene)
        threads = min(threads or usable_cores(), num_envs)
        self._physics = BatchedPhysicsCache(num_envs, threads)
        self._pictures = Pictures(session, threads)
        self._environments: list[_Environment | None] = [None] * num_envs
        self.single_action_space = self._shared.action_space
        self.single_observation_space = self._shared.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Observations, _Infos]:
        """Start trials in all environments, or in the environments of `reset_mask`. Return observations and infos."""
        seeds = self._seeds(seed)
        super().reset(seed=seed if isinstance(seed, int) else None)
        chosen = self._reset_mask(options)
        for k in np.flatnonzero(chosen):
            self._begin_trial(int(k), seeds[k], options)
        if not all(self._environments):
            raise ValueError("`reset_mask` leaves out environments that have not been reset yet; first reset all")
        infos = [self._shared.step_info(self._trial(k)) if chosen[k] else None for k in range(self.num_envs)]
        return self._observe(), _stack_infos(infos)

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[_Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], _Infos]:
        """Simulate one control tick with an action (num_envs, ...) for each environment.

        Return observations, rewards, terminations, truncations (each (num_envs, ...)) and infos.
        """
        values = self._shared.check_actions(actions, self.action_space.shape)
        if not all(self._environments):
            raise ValueError("`step` needs a `reset` before it")
        over = [k for k in range(self.num_envs) if self._environment(k).is_over]
        if over and self._autoreset is AutoresetMode.DISABLED:
            raise ValueError(f"the episodes of environments {over} are over: reset them by `options['reset_mask']`")
        running = [k for k in range(self.num_envs) if k not in set(over)]
        self._simulate_tick(running, values)
        results = {k: self._shared.step_result(self._trial(k)) for k in running}
        for k, result in results.items():
            self._environment(k).is_over = result.terminated or result.truncated
        for k in over:
            self._begin_trial(k)
        final = self._restart_ended() if self._autoreset is AutoresetMode.SAME_STEP else None
        return self._observe(), *self._stack_results(results, final)

    def render(self) -> tuple[Image, ...] | None:
        """Return each environment's image (height, width, 3) of the scene camera in the mode "rgb_array", else None."""
        if self.render_mode is None:
            return None
        camera = self._shared.cameras["scene_rgb"]
        trials = [self._trial(k) for k in range(self.num_envs)]
        return tuple(images[camera] for images in self._pictures.render(trials, (camera,)))

    def close_extras(self, **_: Any) -> None:
        """Free the physics, the renderers and their processes."""
        self._environments = [None] * self.num_envs
        self._physics.close()
        self._pictures.close()
        self._task.close()

    def _environment(self, k: int) -> _Environment:
        found = self._environments[k]
        assert found is not None, "an environment has a trial after the first reset"
        return found

    def _trial(self, k: int) -> RunningTrial:
        return self._environment(k).trial

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"`seed` has {len(seed)} entries, but there are {self.num_envs} environments")
        return list(seed)

    def _reset_mask(self, options: Mapping[str, Any] | None) -> NDArray[np.bool_]:
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, np.bool_)
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"`reset_mask` must be booleans of shape ({self.num_envs},), at least one of them True, not {mask}"
            )
        return mask

    def _begin_trial(self, k: int, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        from .gym_task import trial_job

        before = self._environments[k]
        previous = before.trial.attempt.job if before else None
        self._task.begin_trial(trial_job(previous, seed, options, self.np_random))
        trial = self._task.trial
        physics = self._physics.get(trial.simulator)
        physics.load(k, trial.episode)
        self._environments[k] = _Environment(trial, physics)

    def _simulate_tick(self, running: Iterable[int], actions: NDArray[np.float64]) -> None:
        groups: dict[BatchedPhysics, list[int]] = {}
        for k in running:
            self._trial(k).episode.begin_tick(*self._shared.split_action(actions[k]))
            groups.setdefault(self._environment(k).physics, []).append(k)
        for physics, members in groups.items():
            physics.step(members)
        for k in running:
            self._trial(k).episode.end_tick()

    def _restart_ended(self) -> dict[int, _Observations]:
        """Start the next trial where an episode has ended, and return the last observations of these."""
        ended = [k for k in range(self.num_envs) if self._environment(k).is_over]
        if not ended:
            return {}
        seen = self._observe(ended)
        for k in ended:
            self._begin_trial(k)
        return {k: {key: values[row] for key, values in seen.items()} for row, k in enumerate(ended)}

    def _stack_results(
        self, results: Mapping[int, StepResult], final: Mapping[int, _Observations] | None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], _Infos]:
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros((2, self.num_envs), np.bool_)
        infos: list[_Infos | None] = []
        for k in range(self.num_envs):
            result = results.get(k)
            if result is not None:
                rewards[k], terminated[k], truncated[k], _ = result
            if result is not None and not (final and k in final):
                infos.append(result.info)
            else:
                infos.append(self._shared.step_info(self._trial(k)))
        stacked = _stack_infos(infos)
        if final:
            seen = np.full(self.num_envs, None, dtype=object)
            for k, observation in final.items():
                seen[k] = observation
            there = np.array([k in final for k in range(self.num_envs)])
            last = [results[k].info if k in final else None for k in range(self.num_envs)]
            stacked |= {"final_obs": seen, "_final_obs": there, "final_info": _stack_infos(last), "_final_info": there}
        return rewards, terminated, truncated, stacked

    def _observe(self, chosen: Sequence[int] | None = None) -> _Observations:
        """Return the observations of the chosen environments, by default of all."""
        trials = [self._trial(k) for k in (range(self.num_envs) if chosen is None else chosen)]
        found = create_empty_array(self.single_observation_space, len(trials), fn=np.empty)
        assert isinstance(found, dict)
        for row, trial in enumerate(trials):
            for key, value in self._shared.observe_state(trial).items():
                found[key][row] = value
        if self._shared.observes_images:
            cameras = self._shared.cameras
            for row, images in enumerate(self._pictures.render(trials, tuple(cameras.values()))):
                for key, camera in cameras.items():
                    found[key][row] = images[camera]
        return dict(found)


def _stack_infos(infos: Sequence[Mapping[str, Any] | None]) -> _Infos:
    """Return key -> values (n,) and `_key` -> whether each environment has one, as gymnasium stacks infos."""
    stacked: _Infos = {}
    for key in dict.fromkeys(key for info in infos if info is not None for key in info):
        there = np.array([info is not None and key in info for info in infos])
        values = [info[key] if info is not None and key in info else None for info in infos]
        first = next(value for value, given in zip(values, there, strict=True) if given)
        if isinstance(first, dict):
            stacked[key] = _stack_infos(values)
        else:
            is_number = isinstance(first, bool | int | float)
            array = np.zeros(len(infos), type(first)) if is_number else np.full(len(infos), None, dtype=object)
            array[there] = [value for value, given in zip(values, there, strict=True) if given]
            stacked[key] = array
        stacked[f"_{key}"] = there
    return stacked
