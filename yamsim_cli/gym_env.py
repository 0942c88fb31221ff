"""The task as a gymnasium environment: `gymnasium.make("yamsim/PickPlace-v0")`, registered by importing this module."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from .api import PROGRAM

ENV_ID = "yamsim/PickPlace-v0"

# A joint never gets beyond this, rad; a pose of the workspace never, m.
_FAR = 10.0

# What was let go is slow at first, too: for so many ticks, a quarter of a second, it has to lie still.
_REST_TICKS = 8


class PickPlaceEnv(gymnasium.Env[dict[str, NDArray[Any]], NDArray[np.float32]]):
    """Pick the banana up and put it onto the plate; one step is a control tick of 32 ms.

    The action (8,) is that of `yamsim eval` and of the LeRobot export: seven drives (rad, m), and the weld above 0.5.
    On a rig with two arms it is (16,): the left arm's drives and the right one's, the left weld and the right one. So
    are `joints` (14,) and `ee_pose_world` (2, 4, 4).
    The reward is 1 on success, which ends the episode, else 0. Success is judged as `yamsim pickplace batch` judges,
    with the object let go.

    `reset(seed=S)` starts from trial 0 of seed S, `reset(seed=S, options={"trial": k})` from trial k, the layout that
    `pickplace batch --seed S` has there, and every further `reset()` from the next one.

    Environments that draw in processes of their own (`AsyncVectorEnv`): give `context="forkserver"` or `"spawn"`.
    Linux's default up to Python 3.13 forks: in a process forked from one that has drawn, drawing is a `ResourceError`.

    Args:
        observation: "state" tells where the objects are, and draws nothing; "images" shows them.
        size: width and height of images, px.
        render_mode: None or "rgb_array", the scene camera's image.
        max_ticks: after which the episode is truncated; by default, twice as many as the plan takes.
        rig, task, arm, config, quality: as the flags of `yamsim record`.
    """

    # gymnasium reads it of the class, and declares it of the instance.
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
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r} is not valid: give None or 'rgb_array'")
        if observation not in ("state", "images"):
            raise ValueError(f"observation {observation!r} is not valid: give 'state' or 'images'")
        self.render_mode = render_mode
        self._images = observation == "images"
        drawn = self._images or render_mode is not None
        given: dict[str, Any] = {"rig": rig, "task": task, "arm": arm, "wrist": True, "size": size, "quality": quality}
        if drawn:
            session = PROGRAM.open(config, parallel=False, **given)
            self._config, where, meshes = session.config, session.locations, dict(session.meshes)
        else:
            where, meshes = PROGRAM.locations(), {}
            self._config = PROGRAM.config(config, where, **given)

        from .core.attempt.runner import EpisodeRunner
        from .core.evaluate.observation import policy_cameras
        from .core.policies.base import SCENE, WRIST
        from .core.sim.replica import Replica
        from .core.tasks.kinds import kind_of

        self._max_ticks = max_ticks or 2 * kind_of(self._config.task).ticks(self._config)
        self._runner = EpisodeRunner(self._config, where, meshes, draw=False)
        self._replica = Replica(self._runner.scene)
        self._cameras = policy_cameras(self._config, (SCENE, WRIST))
        self._job: Any = None
        self._loop: Any = None
        self._denied, self._rested = False, 0
        scene = self._runner.scene
        welds = np.tile((0.0, 1.0), (len(scene.arms), 1))
        low, high = np.concatenate([scene.model.actuator_ctrlrange[scene.drives], welds]).T
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.observation_space: spaces.Space[Any] = self._observation_space(size)

    def _observation_space(self, size: tuple[int, int]) -> spaces.Dict:
        def numbers(*shape: int) -> spaces.Box:
            return spaces.Box(-_FAR, _FAR, shape, np.float32)

        arms = len(self._runner.scene.arms)
        hands = (4, 4) if arms == 1 else (arms, 4, 4)
        parts: dict[str, spaces.Space[Any]] = {"joints": numbers(7 * arms), "ee_pose_world": numbers(*hands)}
        if self._images:
            parts |= {key: spaces.Box(0, 255, (size[1], size[0], 3), np.uint8) for key in self._cameras}
        else:
            parts |= {"object_pose_world": numbers(4, 4), "target_pose_world": numbers(4, 4)}
        return spaces.Dict(parts)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start the next trial, or one of a seed."""
        from .core.sim.closed_loop import ClosedLoop
        from .core.types import EpisodeJob

        super().reset(seed=seed)
        trial = (options or {}).get("trial")
        if seed is not None or self._job is None:
            fresh = seed if seed is not None else int(self.np_random.integers(2**31))
            self._job = EpisodeJob(fresh, int(trial or 0))
        else:
            self._job = EpisodeJob(self._job.seed, self._job.attempt + 1 if trial is None else int(trial))
        layout, _, rollout = self._runner.simulate(self._job)
        while layout is None:
            self._job = EpisodeJob(self._job.seed, self._job.attempt + 1)
            layout, _, rollout = self._runner.simulate(self._job)
        scene, task = self._runner.scene, self._config.task
        start = self._runner.start(layout, rollout)
        self._start, self._denied, self._rested = start, False, 0
        self._loop = ClosedLoop(scene, start, task.object.name, task.timing)
        return self._observe(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Let an action act for one control tick."""
        values = np.asarray(action, dtype=np.float64)
        arms = len(self._runner.scene.arms)
        if values.shape != (8 * arms,) or not np.isfinite(values).all():
            raise ValueError(f"an action is {8 * arms} finite numbers, not {values.shape} {values}")
        self._loop.step(values[: 7 * arms], tuple(map(bool, values[7 * arms :] > 0.5)))
        success = self._succeeded()
        truncated = not success and self._loop.ticks >= self._max_ticks
        return self._observe(), float(success), success, truncated, self._info(success)

    def render(self) -> Any:
        """The scene camera's image (height, width, 3) in the mode "rgb_array"."""
        if self.render_mode is None:
            return None
        camera = self._cameras["scene_rgb"]
        return self._runner.draw(self._loop.data.qpos, (camera,))[camera]

    def close(self) -> None:
        """Free the renderer."""
        self._runner.close()

    def _succeeded(self) -> bool:
        loop, task = self._loop, self._config.task
        rests = not loop.holds and loop.rests_on(task.target.name, task.success)
        self._rested = self._rested + 1 if rests else 0
        if self._denied or self._rested < _REST_TICKS:
            return False
        judged, _ = self._runner.repeat(self._start, loop.actions, 0.0, 0.0, planned=False)
        # What the batch does not count, such as an object that was pushed there, stays so.
        self._denied = not judged.success
        return bool(judged.success)

    def _observe(self) -> dict[str, NDArray[Any]]:
        replica, T_base = self._replica, self._runner.scene.T_base_in_world
        replica.show(self._loop.data.qpos)
        seen: dict[str, Any] = {"joints": replica.joints(), "ee_pose_world": T_base @ replica.T_grasp_in_base()}
        if not self._images:
            task = self._config.task
            for key, item in (("object_pose_world", task.object), ("target_pose_world", task.target)):
                seen[key] = T_base @ replica.T_object_in_base(item.name)
        numbers = {key: np.clip(value, -_FAR, _FAR).astype(np.float32) for key, value in seen.items()}
        if not self._images:
            return numbers
        drawn = self._runner.draw(self._loop.data.qpos, tuple(self._cameras.values()))
        return numbers | {key: drawn[camera] for key, camera in self._cameras.items()}

    def _info(self, success: bool = False) -> dict[str, Any]:
        return {
            "seed": self._job.seed,
            "trial": self._job.attempt,
            "time": self._loop.ticks * self._config.task.timing.tick,
            "success": success,
            "holds": self._loop.holds,
        }


def register() -> None:
    """Make `gymnasium.make("yamsim/PickPlace-v0")` work; once is enough, and again does no harm."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(ENV_ID, entry_point=f"{__name__}:{PickPlaceEnv.__name__}")


register()
