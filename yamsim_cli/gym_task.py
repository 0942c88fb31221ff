"""What the gymnasium environments share: the spaces, and observation, reward and info of an episode."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from .core.attempt_data import AttemptJob
from .core.config.recording import RecordConfig
from .core.episode.episode import Episode
from .core.errors import UsageError, suggest_similar
from .core.geometry.se3 import Array, pose
from .core.scene.compiled import CompiledScene
from .gym_options import TaskOptions
from .policies.evaluate.observation import policy_cameras
from .policies.evaluate.stepped_task import RunningTrial
from .policies.policy_protocol import SCENE, WRIST, squeeze_single_arm

_BOUND = 10.0  # rad and m, of the observation space; larger than any joint value or position

Observation = dict[str, NDArray[Any]]


class StepResult(NamedTuple):
    """Result of a control tick: reward, whether the episode terminated or was truncated, and the info."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


class GymTask:
    """Spaces of a task's environments, and what an environment returns for an episode.

    Attributes:
        cameras: key of an observed image -> camera of the scene.
        action_space, observation_space: of one environment.

    Args:
        scene: any scene of the task.
    """

    def __init__(self, config: RecordConfig, options: TaskOptions, scene: CompiledScene) -> None:
        self._config, self._options = config, options
        self.cameras = policy_cameras(self._config, (SCENE, WRIST))
        self.observes_images = options.observation == "images"
        self._prompt = self._config.task.language_prompt
        self._objects = self._objects_by_observed_name()
        self._joint_counts = self._joint_counts_by_observed_name()
        self._drives_shape: tuple[int, int] = scene.recorded_drive_ctrl.shape
        welds = np.tile((0.0, 1.0), (len(scene.arms), 1))
        low, high = np.concatenate([scene.model.actuator_ctrlrange[scene.recorded_drive_ctrl.ravel()], welds]).T
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.observation_space = self._observation_space()
        if options.reach is not None and options.reach not in self._objects:
            raise UsageError(
                f"reach {options.reach!r} is not an object of task {self._config.task.name!r}; "
                f"{suggest_similar(options.reach, self._objects)}"
            )

    def check_actions(self, actions: Any, shape: tuple[int, ...] | None) -> Array:
        """Return actions as floats of a shape; raises ValueError if they have another one or are not finite."""
        values = np.asarray(actions, dtype=np.float64)
        if values.shape != shape or not np.isfinite(values).all():
            count = self._drives_shape[0] * (self._drives_shape[1] + 1)
            raise ValueError(f"an action is {count} finite numbers, not {values.shape} {values}")
        return values

    def split_action(self, action: Array) -> tuple[Array, list[bool]]:
        """Return the drive commands (arms, drives) and the weld commands (arms,) of an action."""
        drives = self._drives_shape[0] * self._drives_shape[1]
        return action[:drives].reshape(self._drives_shape), (action[drives:] > 0.5).tolist()

    def observe_state(self, trial: RunningTrial) -> Observation:
        """Return the numbers of an observation."""
        episode = trial.episode
        scene, world = episode.scene, episode.world
        sites = [episode.data.site(f"{arm.prefix}grasp_site") for arm in scene.arms]
        hands = np.array([pose(site.xpos, site.xmat.reshape(3, 3)) for site in sites])
        seen: dict[str, Array] = {
            "joints": episode.simulated_encoder_readings(trial.attempt.job).ravel(),
            "ee_pose_world": squeeze_single_arm(hands),
        }
        if not self.observes_images:
            seen |= {f"{name}_pose_world": world.pose(item) for name, item in self._objects.items()}
            seen |= {f"{name}_joints": self._object_joints(trial, name) for name in self._joint_counts}
        # `ndarray.clip` calls this with much overhead, which counts with many environments.
        return {key: np.minimum(np.maximum(value, -_BOUND), _BOUND).astype(np.float32) for key, value in seen.items()}

    def step_result(self, trial: RunningTrial) -> StepResult:
        """Return the result of the tick that was stepped."""
        success, truncated = trial.is_successful, trial.out_of_time
        info = self.step_info(trial, success)
        reward = float(success) - info.get("reach", 0.0)
        return StepResult(reward, trial.episode.end is not None and not truncated, truncated, info)

    def step_info(self, trial: RunningTrial, success: bool = False) -> dict[str, Any]:
        """Return the info of a reset, or of a tick with its success."""
        attempt, episode = trial.attempt, trial.episode
        measures = episode.verdict.measures if episode.verdict else ()
        info = {
            "seed": attempt.job.seed,
            "trial": attempt.job.attempt,
            "time": episode.simulated_seconds,
            "success": success,
            "end_rule": self._options.end,
            "holds": any(episode.welds_active),
            "prompt": attempt.phrasing or self._prompt,
            "goal": {one.what: one.margin for one in measures},
        }
        if self._options.reach is not None:
            info["reach"] = self._reach_distance(episode, self._objects[self._options.reach])
        return info

    def _reach_distance(self, episode: Episode, item: str) -> float:
        """Return the distance of the nearest hand's grasp point from an object, m."""
        there = episode.world.pose(item)[:3, 3]
        hands = [episode.data.site(f"{arm.prefix}grasp_site").xpos for arm in episode.scene.arms]
        return float(min(np.linalg.norm(hand - there) for hand in hands))

    def _object_joints(self, trial: RunningTrial, name: str) -> Array:
        """Return the joint positions of an object, m or rad, with zeros for joints that it lacks."""
        model, qpos = trial.episode.scene.model, trial.episode.data.qpos
        item = next(item for item in trial.simulator.config.task.objects if item.name == self._objects[name])
        joints = np.zeros(self._joint_counts[name])
        for k, link in enumerate(item.links):
            joints[k] = qpos[model.joint(f"{item.name}_{link.name}").qposadr[0]]
        return joints

    def _observation_space(self) -> spaces.Dict:
        def unbounded_box(*shape: int) -> spaces.Box:
            return spaces.Box(-_BOUND, _BOUND, shape, np.float32)

        arms, drives = self._drives_shape
        parts: dict[str, spaces.Space[Any]] = {
            "joints": unbounded_box(drives * arms),
            "ee_pose_world": unbounded_box(*((4, 4) if arms == 1 else (arms, 4, 4))),
        }
        if self.observes_images:
            width, height = self._options.size
            parts |= {key: spaces.Box(0, 255, (height, width, 3), np.uint8) for key in self.cameras}
        else:
            parts |= {f"{name}_pose_world": unbounded_box(4, 4) for name in self._objects}
            parts |= {f"{name}_joints": unbounded_box(count) for name, count in self._joint_counts.items()}
        return spaces.Dict(parts)

    def _joint_counts_by_observed_name(self) -> dict[str, int]:
        """Return name in observations -> largest number of joints, for objects with joints."""
        task = self._config.task
        most = {role: max(len(item.links) for item in one.of) for role, one in task.things.items()}
        of_role = {item: role for role in most for item in task.typical_roles.objects_of(role)}
        counts = {name: most[of_role[item]] for name, item in self._objects.items()}
        return {name: count for name, count in counts.items() if count}

    def _objects_by_observed_name(self) -> dict[str, str]:
        """Return name in observations -> object name. The former is the role, or the object if it shares its role."""
        objects = self._config.task.typical_roles.objects_by_role
        return {role if len(names) == 1 else name: name for role, names in objects.items() for name in names}


def trial_job(
    previous: AttemptJob | None, seed: int | None, options: dict[str, Any] | None, rng: np.random.Generator
) -> AttemptJob:
    """Return the trial that a reset starts: the one after `previous`, or one of a seed.

    Args:
        previous: the last trial of the environment; None before its first reset.
        seed: of the trials; if None, the seed of `previous`, or a random one.
        options: of the reset; `trial` is the number of the trial.
    """
    trial = (options or {}).get("trial")
    if seed is None and previous is not None:
        return AttemptJob(previous.seed, previous.attempt + 1 if trial is None else int(trial))
    fresh = seed if seed is not None else int(rng.integers(2**31))
    return AttemptJob(fresh, int(trial or 0))
