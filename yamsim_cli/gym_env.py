"""Tasks as a gymnasium environment. The import registers `gymnasium.make("yamsim/PickPlace-v0")` and `make_vec`."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .gym_options import METADATA, TaskOptions

ENV_ID = "yamsim/PickPlace-v0"


_Observation = dict[str, NDArray[Any]]


class PickPlaceEnv(gymnasium.Env[_Observation, NDArray[np.float32]]):
    """A task, by default to pick an object and place it on a target. A step is a control tick of 32 ms.

    The action has the format of `yamsim eval` and of the LeRobot export. For one YAM arm, the action (8,) has seven
    drive commands (rad, m) and the weld command, which holds above 0.5. For two arms, the action (16,) has the left
    drives, the right drives, the left weld and the right weld. The observations `joints` (14,) and `ee_pose_world`
    (2, 4, 4) of two arms also have the left arm first.
    The reward is 1 on success, which ends the episode, else 0. With `reach="object"`, the distance, m, of this object
    from the nearest hand's `ee_pose_world` is subtracted from the reward, and `info["reach"]` has the distance. An
    episode succeeds at the first tick at which its goal has held for its hold time, as in `yamsim eval`. With
    `end="actor"`, the episode continues until its truncation, and `info["success"]` belongs to the present tick.

    Each object has a pose `<role>_pose_world` (4, 4); an object with moving parts also has `<role>_joints`. Keys name
    roles, so they do not depend on the objects that a trial samples. Joints that an object lacks are 0. Without welds
    in a task, the weld commands have no effect. `info["prompt"]` is the instruction. `info["goal"]` maps each predicate
    to its present margin; a predicate holds if its margin is zero or more.

    `reset(seed=S)` starts trial 0 of seed S, and `reset(seed=S, options={"trial": k})` starts trial k. Each further
    `reset()` starts the next trial. The objects start where `yamsim trials --seed S` places them.

    Environments that render in separate processes (`AsyncVectorEnv`) need `context="forkserver"` or `"spawn"`. Up to
    Python 3.13, Linux forks by default. A process that is forked from a process that has rendered cannot render, and
    raises `ResourceError`.

    Args:
        observation: "state" gives the poses of the objects and renders nothing; "images" gives images instead.
        size: (width, height) of images, px.
        render_mode: None, or "rgb_array" for the image of the scene camera.
        max_ticks: control ticks after which the episode is truncated; by default the time limit of the task.
        end: "success" ends the episode on success; with "actor" only truncation ends the episode.
        reach: an object, as in the keys of poses, whose distance from the hand lowers the reward; none by default.
        rig, task, arm, config, quality: as the flags of `yamsim record`.
    """

    # gymnasium declares an instance attribute, but reads the class attribute.
    metadata: ClassVar[dict[str, Any]] = METADATA  # type: ignore[misc]

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        given = TaskOptions(render_mode=render_mode, **options)
        self.render_mode = render_mode
        session = given.open_session()
        # MuJoCo is imported after the choice of an OpenGL backend.
        from .core.episode.episode_rules import EndRule
        from .gym_task import GymTask
        from .policies.evaluate.stepped_task import SteppedTask

        self._task = SteppedTask(session, EndRule(given.end), given.max_ticks)
        self._shared = GymTask(self._task.config, given, self._task.simulator.scene)
        self._begun = False
        self.action_space = self._shared.action_space
        self.observation_space: gymnasium.Space[Any] = self._shared.observation_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Observation, dict[str, Any]]:
        """Start the next trial, or a given trial of a seed. Return observation and info."""
        from .gym_task import trial_job

        super().reset(seed=seed)
        previous = self._task.attempt.job if self._begun else None
        self._task.begin_trial(trial_job(previous, seed, options, self.np_random))
        self._begun = True
        return self._observe(), self._shared.step_info(self._task.trial)

    def step(self, action: NDArray[np.float32]) -> tuple[_Observation, float, bool, bool, dict[str, Any]]:
        """Simulate one control tick with an action. Return observation, reward, terminated, truncated and info."""
        values = self._shared.check_actions(action, self._shared.action_space.shape)
        self._task.episode.step(*self._shared.split_action(values))
        return self._observe(), *self._shared.step_result(self._task.trial)

    def render(self) -> Any:
        """Return the image (height, width, 3) of the scene camera in the mode "rgb_array", else None."""
        if self.render_mode is None:
            return None
        camera = self._shared.cameras["scene_rgb"]
        return self._task.trial.render((camera,))[camera]

    def close(self) -> None:
        """Free the renderers."""
        self._task.close()

    def _observe(self) -> _Observation:
        numbers = self._shared.observe_state(self._task.trial)
        if not self._shared.observes_images:
            return numbers
        cameras = self._shared.cameras
        images = self._task.trial.render(tuple(cameras.values()))
        return numbers | {key: images[camera] for key, camera in cameras.items()}


def register() -> None:
    """Register the environment for `gymnasium.make` and `make_vec`. A second call has no effect."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point=f"{__name__}:{PickPlaceEnv.__name__}",
            vector_entry_point=f"{__package__}.vector_env:PickPlaceVectorEnv",
        )


register()
