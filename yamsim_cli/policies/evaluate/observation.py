from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from yamsim_cli.core.attempt_data import Attempt
from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.dataset.environment_state import joints_key, object_pose_keys
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import UsageError, suggest_similar
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image

from ..policy_protocol import OBJECTS, SCENE, VELOCITIES, WRIST, squeeze_single_arm

# (MuJoCo's positions (nq,), name of a camera) -> image.
CameraRenderer = Callable[[Array, str], Image]


def available_cameras(config: RecordConfig) -> dict[str, dict[str, str]]:
    """Return requested name -> {key of an observation: camera of the scene}."""
    if len(config.rig.arms) == 1:
        arm = config.rig.arms[0]
        side = f"{arm.side}_wrist"
        there = {WRIST: {"wrist_rgb": arm.wrist_camera_name}, side: {f"{side}_rgb": arm.wrist_camera_name}}
    else:
        sides = {f"{arm.side}_wrist": {f"{arm.side}_wrist_rgb": arm.wrist_camera_name} for arm in config.wrist_arms}
        there = sides | {WRIST: {key: camera for one in sides.values() for key, camera in one.items()}}
    there[SCENE] = {"scene_rgb": SCENE_CAMERA}
    if config.rig.cameras:
        there |= {name: {f"{name}_rgb": name} for name in config.recorded_cameras}
    return there


def policy_cameras(config: RecordConfig, images: Iterable[str]) -> dict[str, str]:
    """Return key of an observation -> camera of the scene, for the requested images."""
    where = f"rig {config.rig.name!r} with task {config.task.name!r}"
    return select_cameras(images, available_cameras(config), where)


def select_cameras(images: Iterable[str], available: Mapping[str, Mapping[str, str]], where: str) -> dict[str, str]:
    """Return key of an observation -> camera of the scene, for the requested images.

    Args:
        available: name of an image -> its keys and cameras.
        where: what lacks an image that is not available, in the message.

    Raises UsageError if an image is not available.
    """
    cameras: dict[str, str] = {}
    for name in images:
        if name not in available:
            hint = suggest_similar(name, available)
            raise UsageError(f"the policy asks for the image {name!r}, which {where} does not have; {hint}")
        cameras |= available[name]
    return cameras


class ObservationRenderer:
    """Renders the images of one trial's observations. `failure` is an exception of rendering, not of the policy."""

    def __init__(self, render: CameraRenderer) -> None:
        self._render = render
        self._thread = threading.get_ident()
        self._is_over = False
        self.failure: Exception | None = None

    def render(self, key: str, qpos: Array, camera: str) -> Image:
        """Render a camera at MuJoCo's positions (nq,). `key` names the image in error messages.

        Raise RuntimeError in another thread, where OpenGL cannot render, or after the trial.
        """
        hint = f"read observation[{key!r}], or dict(observation) for all, while the policy is called"
        if threading.get_ident() != self._thread:
            raise RuntimeError(f"{key} cannot be rendered in another thread: {hint}, and pass the result on")
        if self._is_over:
            raise RuntimeError(f"{key} cannot be rendered once its trial is over: {hint}")
        try:
            return self._render(qpos, camera)
        # A policy may swallow the exception; `failure` keeps it.
        except Exception as error:
            self.failure = error
            raise

    def finish(self) -> None:
        """End the trial, after which `render` refuses."""
        self._is_over = True


class LazyObservation(Mapping[str, Any]):
    """Observation whose images are rendered at the first access, in the state of the observation.

    `dict(observation)` renders all images. Listing the keys renders none.

    Args:
        numbers: key -> value, for all keys except images.
        qpos: MuJoCo's positions (nq,), which the caller must not change.
    """

    def __init__(
        self, numbers: dict[str, Any], qpos: Array, cameras: Mapping[str, str], renderer: ObservationRenderer
    ) -> None:
        self._known, self._qpos, self._cameras, self._renderer = numbers, qpos, cameras, renderer
        self._keys = (*numbers, *cameras)

    def __getitem__(self, key: str) -> Any:
        if key not in self._known and key in self._cameras:
            self._known[key] = self._renderer.render(key, self._qpos, self._cameras[key])
        return self._known[key]

    def __contains__(self, key: object) -> bool:
        return key in self._known or key in self._cameras

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._keys)})"

    def __reduce__(self) -> tuple[type[dict[str, Any]], tuple[dict[str, Any]]]:
        return dict, (dict(self),)


class ObservationBuilder:
    """Builds the observations of a policy."""

    def __init__(self, simulator: Simulator, images: Iterable[str], wants: Iterable[str]) -> None:
        self._simulator = simulator
        self._cameras = policy_cameras(simulator.config, images)
        self._wants = frozenset(wants)

    @property
    def drive_shape(self) -> tuple[int, int]:
        """Numbers of arms, and of drives of each arm."""
        arms, drives = self._simulator.scene.recorded_drive_ctrl.shape
        return arms, drives

    def observe(self, episode: Episode, attempt: Attempt, renderer: ObservationRenderer) -> LazyObservation:
        """Return the observation of the current state. `renderer` renders its images when they are read."""
        config, scene, replica = self._simulator.config, self._simulator.scene, self._simulator.state_replay
        task = config.task
        replica.set_state(episode.data.qpos)
        T_base = scene.T_base_in_world
        joints = episode.simulated_encoder_readings(attempt.job)
        openings = joints[:, -1] if scene.first_arm.fingers is not None else replica.finger_openings()
        numbers: dict[str, Any] = {
            "joints": joints.ravel(),
            "gripper": openings if len(openings) > 1 else float(openings[0]),
            "ee_pose_world": squeeze_single_arm(T_base @ replica.T_grasp_in_base()),
            "K_scene": self._simulator.intrinsics(SCENE_CAMERA).K,
            "T_cam_in_world": T_base @ replica.T_cam_in_base(SCENE_CAMERA),
            "time": episode.simulated_seconds,
            "prompt": attempt.phrasing or task.language_prompt,
        }
        if OBJECTS in self._wants:
            numbers |= {key: T_base @ replica.T_object_in_base(name) for name, key in object_pose_keys(config).items()}
            numbers |= {joints_key(item.name): replica.object_joints(item) for item in task.objects if item.links}
        if VELOCITIES in self._wants:
            numbers["joint_velocities"] = episode.joint_velocities.ravel()
        return LazyObservation(numbers, episode.data.qpos.copy(), self._cameras, renderer)
