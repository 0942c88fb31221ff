"""The config of `--env.type=yamsim`, which makes the environments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.envs.utils import _LazyAsyncVectorEnv, freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from yamsim_cli.station import StationForm, StationSettings

from .environment import ENVIRONMENT, STATE, YamsimEnv, read_settings


@EnvConfig.register_subclass("yamsim")
@dataclass
class YamsimEnvConfig(EnvConfig):
    """One or several yamsim tasks. The default of each setting is that of `yamsim record`.

    Observations and actions have the names and units of `yamsim export lerobot`, so a policy that was trained on an
    export fits. LeRobot's seed `s` is trial `s` of the seed `trials_of`, with the start of `yamsim eval --seed` of that
    seed.

    Attributes:
        task: a yamsim task, or several with commas between them.
        fps: frames a second, each with one action: the rate of the recordings that a policy was trained on.
        action: "drives", which ends in each arm's weld, or "joints", with grippers as shares.
        size: width and height of pictures, px.
        cameras: in order.
        pictures: whether observations have pictures; videos are made in any case.
        environment_state: whether observations have the poses of things.
        trials_of: seed of the trials.
        max_frames: limit of a trial's frames; by default that of the task's `time_limit_s`.
        rig, arm, grasp, quality, randomize, config: as the flags of `yamsim record`.
    """

    task: str | None = "pickplace"
    fps: float = 15.625
    rig: str | None = None
    arm: str | None = None
    grasp: str | None = None
    action: str | None = None
    size: str = "640x480"
    quality: str | None = None
    cameras: list[str] | None = None
    randomize: bool | None = None
    config: str = "default"
    pictures: bool = True
    environment_state: bool = False
    trials_of: int = 0
    max_frames: int | None = None

    def __post_init__(self) -> None:
        """Set the features of observations and actions, from configs alone.

        Raises:
            ValueError: a setting is not valid, or the tasks need different policies.
        """
        forms = {task: read_settings(settings) for task, settings in self.station_settings().items()}
        first, form = next(iter(forms.items()))
        for task, other in forms.items():
            if self._shown(other) != self._shown(form):
                raise ValueError(
                    f"--env.task={self.task}: one policy cannot do {first} and {task}: joints, cameras or objects "
                    "differ; give --env.rig and --env.cameras that suit both, or evaluate them one by one"
                )
        numbers = {STATE: (FeatureType.STATE, form.state, OBS_STATE), ACTION: (FeatureType.ACTION, form.action, ACTION)}
        if self.environment_state:
            numbers[ENVIRONMENT] = (FeatureType.ENV, form.environment, OBS_ENV_STATE)
        for key, (kind, names, theirs) in numbers.items():
            self.features[key] = PolicyFeature(type=kind, shape=(len(names),))
            self.features_map[key] = theirs
        for camera, shape in form.cameras.items() if self.pictures else ():
            # Recordings of trials know pictures by this name alone.
            key = f"{OBS_IMAGES}.{camera}"
            self.features[key] = PolicyFeature(type=FeatureType.VISUAL, shape=shape)
            self.features_map[key] = key

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Not used: `create_envs` makes the environments."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """Task -> 0 -> `n_envs` environments, in separate processes if requested.

        A task's processes start with its first trial, so that the processes of several tasks do not run at once.
        """
        made: dict[str, dict[int, VectorEnv]] = {}
        for task, settings in self.station_settings().items():
            one = partial(
                YamsimEnv,
                settings,
                pictures=self.pictures,
                environment_state=self.environment_state,
                trials_of=self.trials_of,
                max_frames=self.max_frames,
            )
            if use_async_envs and n_envs > 1:
                made[task] = {0: _LazyAsyncVectorEnv([one] * n_envs)}
            else:
                frozen = [freeze_after_episode_end(one)] * n_envs
                made[task] = {0: SyncVectorEnv(frozen, autoreset_mode=AutoresetMode.NEXT_STEP)}
        return made

    def _shown(self, form: StationForm) -> tuple[object, ...]:
        """The parts of a station's form that a policy depends on."""
        return (
            form.state,
            form.action,
            form.cameras if self.pictures else None,
            form.environment if self.environment_state else None,
        )

    def station_settings(self) -> dict[str, StationSettings]:
        """Task -> settings of its station."""
        tasks = [task.strip() for task in (self.task or "").split(",") if task.strip()]
        if not tasks:
            raise ValueError("--env.task is empty: give a task, such as pickplace; `yamsim tasks list` shows them")
        return {
            task: StationSettings(
                task=task,
                rig=self.rig,
                arm=self.arm,
                grasp=self.grasp,
                action=self.action,
                fps=self.fps,
                size=self.size,
                quality=self.quality,
                cameras=tuple(self.cameras) if self.cameras else None,
                randomize=self.randomize,
                config=self.config,
                spelling="--env.{}",
            )
            for task in tasks
        }
