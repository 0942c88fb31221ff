"""What `--env.type=yamsim` takes, and the environments that come of it."""

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
    """One or several of yamsim's tasks. What is left out is as `yamsim record` has it.

    Observations and actions are called and measured as `yamsim export lerobot` has them, so that a policy that was
    trained on an export fits. Seed `s` of LeRobot's is trial `s` of the seed `trials_of`: the start that `yamsim eval
    --seed` of that seed has there.

    Attributes:
        task: a task of yamsim's, or several with commas between them.
        fps: frames a second, of which each has one action: those of the recordings that a policy was trained on.
        action: "drives", which ends in each arm's weld, or "joints", with grippers as shares.
        size: width and height of pictures, px.
        cameras: which to show, in order.
        pictures: whether policies are shown any; videos are made in any case.
        environment_state: whether policies are told where things are.
        trials_of: seed of the trials.
        max_frames: a trial's longest; as long as the task's `time_limit_s`, unless given.
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
        """Fill in what policies are shown, from the configs alone.

        Raises:
            ValueError: a setting is not valid, or one policy cannot do all the tasks.
        """
        forms = {task: read_settings(settings) for task, settings in self._settings().items()}
        first, form = next(iter(forms.items()))
        for task, other in forms.items():
            if self._shown(other) != self._shown(form):
                raise ValueError(
                    f"--env.task={self.task}: one policy cannot do {first} and {task}: joints, cameras or things "
                    "differ; give --env.rig and --env.cameras that suit both, or evaluate them one by one"
                )
        numbers = {STATE: (FeatureType.STATE, form.state, OBS_STATE), ACTION: (FeatureType.ACTION, form.action, ACTION)}
        if self.environment_state:
            numbers[ENVIRONMENT] = (FeatureType.ENV, form.environment, OBS_ENV_STATE)
        for key, (kind, names, theirs) in numbers.items():
            self.features[key] = PolicyFeature(type=kind, shape=(len(names),))
            self.features_map[key] = theirs
        for camera, shape in form.cameras.items() if self.pictures else ():
            # Of pictures, recordings of trials know them by this name alone.
            key = f"{OBS_IMAGES}.{camera}"
            self.features[key] = PolicyFeature(type=FeatureType.VISUAL, shape=shape)
            self.features_map[key] = key

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Not used: `create_envs` makes the environments."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """Task -> 0 -> so many environments of it, in processes of their own if that is asked for.

        A task's processes start when its first trial does, so that those of several tasks do not run all at once.
        """
        made: dict[str, dict[int, VectorEnv]] = {}
        for task, settings in self._settings().items():
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
        """What of a station a policy depends on."""
        return (
            form.state,
            form.action,
            form.cameras if self.pictures else None,
            form.environment if self.environment_state else None,
        )

    def _settings(self) -> dict[str, StationSettings]:
        """Task -> the station where it is done."""
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
