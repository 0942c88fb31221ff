"""Tasks as a gymnasium environment. The import registers `gymnasium.make("yamsim/PickPlace-v0")`."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from .api import API_SESSION_OPENER
from .core.config.session import Session

ENV_ID = "yamsim/PickPlace-v0"

_OBSERVATION_BOUND = 10.0  # rad and m, of the observation space; larger than any joint value or position


class PickPlaceEnv(gymnasium.Env[dict[str, NDArray[Any]], NDArray[np.float32]]):
    """A task, by default to pick an object and place it on a target. A step is a control tick of 32 ms.

    The action has the format of `yamsim eval` and of the LeRobot export. For one YAM arm, the action (8,) has seven
    drive commands (rad, m) and the weld command, which holds above 0.5. For two arms, the action (16,) has the left
    drives, the right drives, the left weld and the right weld. The observations `joints` (14,) and `ee_pose_world`
    (2, 4, 4) of two arms also have the left arm first.
    The reward is 1 on success, which ends the episode, else 0. An episode succeeds at the first tick at which its goal
    has held for its hold time, as in `yamsim eval`. With `end="actor"`, the episode continues until its truncation, and
    `info["success"]` belongs to the present tick.

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
        rig, task, arm, config, quality: as the flags of `yamsim record`.
    """

    # gymnasium declares an instance attribute, but reads the class attribute.
    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": 31,
    }

    def __init__(
        self,
        render_mode: str | None = None,
        *,
        observation: Literal["state", "images"] = "state",
        size: tuple[int, int] = (320, 240),
        max_ticks: int | None = None,
        rig: str | None = None,
        task: str | None = None,
        arm: str | None = None,
        config: str = "default",
        quality: str = "fast",
        end: Literal["success", "actor"] = "success",
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r} is not valid: give None or 'rgb_array'")
        if observation not in ("state", "images"):
            raise ValueError(f"observation {observation!r} is not valid: give 'state' or 'images'")
        self.render_mode = render_mode
        self._images = observation == "images"
        given: dict[str, Any] = {"rig": rig, "task": task, "arm": arm, "wrist": True, "size": size, "quality": quality}
        if self._images or render_mode is not None:
            session = API_SESSION_OPENER.open(config, parallel=False, **given)
        else:
            # Neither set up nor disable OpenGL: another environment of this process may render.
            where = API_SESSION_OPENER.find_locations()
            session = Session(API_SESSION_OPENER.load_record_config(config, where, **given), where)

        from .core.episode.episode_rules import EndRule
        from .policies.evaluate.observation import policy_cameras
        from .policies.evaluate.stepped_task import SteppedTask
        from .policies.policy_protocol import SCENE, WRIST

        self._task = SteppedTask(session, EndRule(end), max_ticks)
        self._config = session.config
        self._cameras = policy_cameras(self._config, (SCENE, WRIST))
        self._begun = False
        scene = self._task.simulator.scene
        welds = np.tile((0.0, 1.0), (len(scene.arms), 1))
        low, high = np.concatenate([scene.model.actuator_ctrlrange[scene.recorded_drive_ctrl.ravel()], welds]).T
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.observation_space: spaces.Space[Any] = self._observation_space(size)

    def _observation_space(self, size: tuple[int, int]) -> spaces.Dict:
        def unbounded_box(*shape: int) -> spaces.Box:
            return spaces.Box(-_OBSERVATION_BOUND, _OBSERVATION_BOUND, shape, np.float32)

        arms, drives = self._task.simulator.scene.recorded_drive_ctrl.shape
        hands = (4, 4) if arms == 1 else (arms, 4, 4)
        parts: dict[str, spaces.Space[Any]] = {
            "joints": unbounded_box(drives * arms),
            "ee_pose_world": unbounded_box(*hands),
        }
        if self._images:
            parts |= {key: spaces.Box(0, 255, (size[1], size[0], 3), np.uint8) for key in self._cameras}
        else:
            parts |= {key: unbounded_box(4, 4) for key in self._objects_by_pose_key()}
            parts |= {key: unbounded_box(count) for key, (_, count) in self._objects_by_joints_key().items()}
        return spaces.Dict(parts)

    def _objects_by_pose_key(self) -> dict[str, str]:
        return {f"{role}_pose_world": item for role, item in self._objects_by_observed_name().items()}

    def _objects_by_joints_key(self) -> dict[str, tuple[str, int]]:
        """Return observation key -> object whose joints it has, and the maximum number of joints."""
        task = self._config.task
        roles = task.typical_roles
        most = {role: max(len(item.links) for item in one.of) for role, one in task.things.items()}
        of_role = {item: role for role in most for item in roles.objects_of(role)}
        return {
            f"{name}_joints": (item, most[of_role[item]])
            for name, item in self._objects_by_observed_name().items()
            if most[of_role[item]]
        }

    def _objects_by_observed_name(self) -> dict[str, str]:
        """Return name in observations -> object name. The former is the role, or the object if it shares its role."""
        objects = self._config.task.typical_roles.objects_by_role
        return {role if len(names) == 1 else name: name for role, names in objects.items() for name in names}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start the next trial, or a given trial of a seed. Return observation and info."""
        from .core.attempt_data import AttemptJob

        super().reset(seed=seed)
        trial = (options or {}).get("trial")
        if seed is not None or not self._begun:
            fresh = seed if seed is not None else int(self.np_random.integers(2**31))
            job = AttemptJob(fresh, int(trial or 0))
        else:
            before = self._task.attempt.job
            job = AttemptJob(before.seed, before.attempt + 1 if trial is None else int(trial))
        self._task.begin_trial(job)
        self._begun = True
        return self._observe(), self._step_info()

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Simulate one control tick with an action. Return observation, reward, terminated, truncated and info."""
        values = np.asarray(action, dtype=np.float64)
        drives = self._task.simulator.scene.recorded_drive_ctrl
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            count = drives.size + len(drives)
            raise ValueError(f"an action is {count} finite numbers, not {values.shape} {values}")
        self._task.episode.step(values[: drives.size].reshape(drives.shape), values[drives.size :] > 0.5)
        success, end = self._task.is_successful, self._task.episode.end
        terminated = end is not None and not self._task.out_of_time
        return self._observe(), float(success), terminated, self._task.out_of_time, self._step_info(success)

    def render(self) -> Any:
        """Return the image (height, width, 3) of the scene camera in the mode "rgb_array", else None."""
        if self.render_mode is None:
            return None
        camera = self._cameras["scene_rgb"]
        return self._task.render((camera,))[camera]

    def close(self) -> None:
        """Free the renderers."""
        self._task.close()

    def _observe(self) -> dict[str, NDArray[Any]]:
        from .policies.policy_protocol import squeeze_single_arm

        simulator, episode = self._task.simulator, self._task.episode
        replica, T_base = simulator.state_replay, simulator.scene.T_base_in_world
        replica.set_state(episode.data.qpos)
        hands = squeeze_single_arm(T_base @ replica.T_grasp_in_base())
        seen: dict[str, Any] = {
            "joints": episode.simulated_encoder_readings(self._task.attempt.job).ravel(),
            "ee_pose_world": hands,
        }
        if not self._images:
            seen |= {key: T_base @ replica.T_object_in_base(name) for key, name in self._objects_by_pose_key().items()}
            items = {item.name: item for item in simulator.config.task.objects}
            for key, (name, count) in self._objects_by_joints_key().items():
                joints = replica.object_joints(items[name])
                seen[key] = np.pad(joints, (0, count - len(joints)))
        numbers = {
            key: np.clip(value, -_OBSERVATION_BOUND, _OBSERVATION_BOUND).astype(np.float32)
            for key, value in seen.items()
        }
        if not self._images:
            return numbers
        images = self._task.render(tuple(self._cameras.values()))
        return numbers | {key: images[camera] for key, camera in self._cameras.items()}

    def _step_info(self, success: bool = False) -> dict[str, Any]:
        task, episode = self._task, self._task.episode
        measures = episode.verdict.measures if episode.verdict else ()
        return {
            "seed": task.attempt.job.seed,
            "trial": task.attempt.job.attempt,
            "time": episode.simulated_seconds,
            "success": success,
            "end_rule": task.rules.end.value,
            "holds": any(episode.welds_active),
            "prompt": task.attempt.phrasing or self._config.task.language_prompt,
            "goal": {one.what: one.margin for one in measures},
        }


def register() -> None:
    """Register the environment for `gymnasium.make("yamsim/PickPlace-v0")`. A second call has no effect."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(ENV_ID, entry_point=f"{__name__}:{PickPlaceEnv.__name__}")


register()
