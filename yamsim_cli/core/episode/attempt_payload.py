from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ..attempt_data import Attempt, AttemptPayload, StepState
from ..config.recording import RecordConfig
from ..dataset.dataset_paths import (
    TRUTH_LABELS_FILE,
    depth_path,
    image_path,
    lowdim_path,
    segmentation_path,
    truth_path,
)
from ..dataset.ground_truth_files import array_specs, dump_arrays, dump_depth
from ..dataset.lowdim import SimulationData, content_hash, dump_frame, make_frame
from ..dataset.records import to_json
from ..geometry.se3 import Array, invert_pose
from ..images.image import Image
from ..images.jpeg import encode_jpeg
from ..images.png import encode_labels
from ..rendering.frame_truth import depth_in_mm, measure_frame
from ..rendering.renderer import SceneRenderer
from ..rendering.scene_labels import SceneLabels
from ..sim.encoder_readings import encoder_readings
from .execution import SimulatedAttempt
from .simulator import Simulator

# Version of the rendering, raised when the same config gives other images: 2 since the table and the posts cast
# shadows.
APPEARANCE_REVISION = "2"

# Version of the engine, raised when the same config and seed give other actions. 2: all tasks are programs of skills,
# with analytic inverse kinematics. 3: waypoints may tilt, containers take objects beside each other, and starts with
# moving objects are sampled again.
SIMULATION_REVISION = "3"


def library_versions() -> dict[str, str]:
    """Return name -> version of software that determines an episode's files; `looks` affects only images."""
    packages = {name: name for name in ("mujoco", "mink", "daqp", "numpy")} | {"opencv": "opencv-python-headless"}
    return {
        "yamsim": __version__,
        "python": platform.python_version(),
        "looks": APPEARANCE_REVISION,
        "engine": SIMULATION_REVISION,
    } | {key: version(name) for key, name in packages.items()}


def build_payload(simulator: Simulator, simulated: SimulatedAttempt) -> AttemptPayload:
    """Return the payload of an attempt, with rendered files for a success."""
    if not simulated.outcome.success:
        return payload_without_files(simulated)
    recorded = frame_records(simulator, simulated.attempt, simulated.recorded_states)
    files = {lowdim_path(k): dump_frame(frame) for k, frame in enumerate(recorded)}
    files |= encode_images(simulator, simulated.attempt, [state.qpos for state in simulated.recorded_states])
    return AttemptPayload(
        simulated.attempt,
        simulated.outcome,
        files,
        len(recorded),
        content_hash(recorded),
        library_versions(),
        simulator.renderer.description if simulator.scene.cameras else "",
    )


def payload_without_files(simulated: SimulatedAttempt) -> AttemptPayload:
    """Return the payload of an attempt with its outcome only."""
    return AttemptPayload(simulated.attempt, simulated.outcome)


def frame_records(simulator: Simulator, attempt: Attempt, states: Sequence[StepState]) -> list[dict[str, Any]]:
    """Return joints, poses and commands of each state, by the keys of `dataset.lowdim`."""
    ticks_per_frame = simulator.config.task.timing.ticks_per_frame
    return [_frame_record(simulator, attempt, state, k * ticks_per_frame) for k, state in enumerate(states)]


def _object_joints(simulator: Simulator) -> dict[str, Array]:
    return {
        item.name: simulator.state_replay.object_joints(item) for item in simulator.config.task.objects if item.links
    }


def _frame_record(simulator: Simulator, attempt: Attempt, state: StepState, tick: int) -> dict[str, Any]:
    config, scene, replica = simulator.config, simulator.apply_randomization(attempt), simulator.state_replay
    task, acting = config.task, state.actions
    replica.set_state(state.qpos)
    joints = replica.joint_positions() if state.encoder_readings is None else state.encoder_readings
    bases = [arm.T_base_in_world for arm in scene.arms]
    return make_frame(
        joints=encoder_readings(scene, joints, attempt.job, tick),
        timestamp=state.time,
        **camera_entries(simulator),
        object_poses={item.name: replica.T_object_in_base(item.name) for item in task.objects},
        object_joints=_object_joints(simulator),
        cloth_points=replica.cloth_points(),
        ee_pose=replica.T_grasp_in_base(),
        ctrl=(acting.ctrl[0] if state.intended is None else state.intended)[scene.recorded_drive_ctrl],
        action_joints=acting.joints[0],
        magnet=acting.magnet[0],
        language_task=task.language_task or task.name,
        language_prompt=attempt.phrasing or task.language_prompt,
        wrist_camera=config.wrist_arms[0].wrist_camera_name if len(config.wrist_arms) == 1 else None,
        T_right_base_in_left_base=invert_pose(bases[0]) @ bases[1] if len(bases) > 1 else None,
        full_openings=max_finger_openings(config) if config.action == "joints" else None,
        simulation=SimulationData(state.qpos, acting.ctrl, acting.magnet),
    )


def camera_entries(simulator: Simulator) -> dict[str, dict[str, Array]]:
    """Return `intrinsics` and `extrinsics` of the recorded cameras in the state of the simulator's replay."""
    cameras = simulator.scene.cameras
    return {
        "intrinsics": {name: simulator.intrinsics(name).K for name in cameras},
        "extrinsics": {name: simulator.state_replay.T_cam_in_base(name) for name in cameras},
    }


def max_finger_openings(config: RecordConfig) -> list[float]:
    """Return each arm's largest finger opening, m, in the recordings' order, without arms that lack fingers."""
    fingers = [config.rig.arms[k].robot.fingers for k in config.rig.recording_order]
    return [each.full_opening for each in fingers if each is not None]


def render_cameras(simulator: Simulator, attempt: Attempt, qpos: Array, cameras: Sequence[str]) -> dict[str, Image]:
    """Return camera -> RGB image (height, width, 3), without image noise."""
    renderer = _prepare_renderer(simulator, attempt)
    simulator.state_replay.set_state(qpos)
    return {camera: renderer.render(simulator.state_replay.data, camera) for camera in cameras}


def render_recorded_images(
    simulator: Simulator, attempt: Attempt, positions: Iterable[Array]
) -> Iterator[tuple[int, str, Image]]:
    """Yield frame, camera and RGB image (height, width, 3); each image reuses the memory of the last.

    Until the next image, the simulator's replay has the state that the image shows.
    """
    width, height = simulator.config.image.size_px
    image = np.empty((height, width, 3), np.uint8)
    renderer, replica, job = _prepare_renderer(simulator, attempt), simulator.state_replay, attempt.job
    effects, states = simulator.effects_cameras, list(positions)
    for k, qpos in enumerate(states):
        replica.set_state(qpos)
        for number, camera in enumerate(simulator.scene.cameras):
            if camera in effects:
                effects[camera].take(renderer, replica, states, k, image)
            else:
                renderer.render(replica.data, camera, image)
            simulator.randomized_scene.augment_image(attempt, image, k, number)
            if camera in effects:
                effects[camera].expose(image, job.for_look(simulator.config.look), k)
            yield k, camera, image
            if camera in effects:
                replica.set_state(qpos)


def encode_images(simulator: Simulator, attempt: Attempt, positions: Iterable[Array]) -> dict[str, bytes]:
    """Return path in the episode -> content, for JPEGs, and for ground truth if the config has `truth`."""
    files: dict[str, bytes] = {}
    truth: GroundTruthCollector | None = None
    if simulator.labels is not None:
        truth = GroundTruthCollector(simulator.labels, simulator.scene.cameras, simulator.scene.T_base_in_world)
    for k, camera, image in render_recorded_images(simulator, attempt, positions) if simulator.scene.cameras else ():
        files[image_path(camera, k)] = encode_jpeg(image, simulator.config.image.jpeg_quality)
        if truth:
            truth.add(simulator.state_replay.data, camera, simulator.renderer)
    return files | (truth.files if truth else {})


def render_depth(simulator: Simulator, attempt: Attempt, qpos: Array, camera: str) -> NDArray[np.uint16]:
    """Return a depth image (height, width) in mm, for a config with `truth`."""
    assert simulator.labels is not None, "depth is part of truth"
    renderer = _prepare_renderer(simulator, attempt)
    simulator.state_replay.set_state(qpos)
    # Pixels without a label, such as the sky, get no depth, as in recorded ground truth.
    labels = simulator.labels
    return depth_in_mm(
        renderer.render_labels_and_depth(
            simulator.state_replay.data, camera, labels.label_of_geom, labels.label_of_flex
        )[1]
    )


def _prepare_renderer(simulator: Simulator, attempt: Attempt) -> SceneRenderer:
    simulator.apply_randomization(attempt)
    simulator.randomized_scene.upload_textures(simulator.renderer)
    return simulator.renderer


class GroundTruthCollector:
    """Collects an episode's ground truth: `add` every camera's frames in order, then read `files`."""

    def __init__(self, labels: SceneLabels, cameras: Sequence[str], T_base_in_world: Array) -> None:
        self._labels = labels
        self._T_base_in_world = T_base_in_world
        self._rows: dict[str, list[dict[str, NDArray[Any]]]] = {camera: [] for camera in cameras}
        self._intrinsics: dict[str, Array] = {}
        self._files: dict[str, bytes] = {}

    def add(self, data: mujoco.MjData, camera: str, renderer: SceneRenderer) -> None:
        """Measure a camera's next frame."""
        truth = measure_frame(data, camera, renderer, self._labels, self._T_base_in_world)
        frame = len(self._rows[camera])
        self._rows[camera].append(truth.arrays)
        self._intrinsics[camera] = renderer.intrinsics(camera).K
        self._files[depth_path(camera, frame)] = dump_depth(truth.depth_mm)
        self._files[segmentation_path(camera, frame)] = encode_labels(truth.labels)

    @property
    def files(self) -> dict[str, bytes]:
        """Path in the episode -> content."""
        files = dict(self._files)
        for camera, rows in self._rows.items():
            specs = array_specs(self._labels.names, len(rows))
            arrays = {"intrinsics": self._intrinsics[camera]} | {
                key: np.stack([row[key] for row in rows]).astype(dtype)
                for key, (dtype, _) in specs.items()
                if key in rows[0]
            }
            files[truth_path(camera)] = dump_arrays(arrays)
        files[TRUTH_LABELS_FILE] = to_json(self._labels.names, indent=1)
        return files
