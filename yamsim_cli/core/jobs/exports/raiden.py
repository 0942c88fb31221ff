"""Export to the converted layout of the real stack, see `raiden_schema`: what reads real recordings reads this."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...config.limits import load_limits
from ...dataset.layout import depth_name
from ...dataset.lowdim import dump_frame
from ...dataset.reader import StoredEpisode
from ...errors import DatasetError
from ...geometry.se3 import Array, inverse, rotation_vector
from ...planning.kinematics import ArmKinematics
from ...resources import Locations
from ...scene.robot import bare_arm
from ..episode import require_one_arm
from . import raiden_schema as schema
from .source import Exported, Progress, Source, depth_cameras
from .target import export_directory

# A lone arm is the left one, and so is its camera.
_LEFT_WRIST_CAMERA = "left_wrist_camera"

_ZERO_TIME = "1970-01-01T00:00:00.000000"


def export_raiden(
    source: Source, out: Path, locations: Locations, progress: Progress, *, overwrite: bool = False
) -> Exported:
    """Write a dataset in the real stack's layout; images and depth byte for byte as they are.

    The global frame is the base of the left arm. A lone arm is the left one; the right one is still, with all joints 0.
    Grippers are a share of the opening, 0 closed and 1 open, as the real arm's drive reports them.

    Raises:
        ConfigError: the rig has more than one arm.
        DatasetError: a file is missing, altered or damaged.
        UsageError, PartialJobError, InterruptedJobError: see `export_directory`.
    """
    require_one_arm(source.config)
    converter = _Converter(source, locations)
    frames: dict[str, int] = {}
    with export_directory(out, overwrite=overwrite) as stage:
        first: Mapping[str, Any] = {}
        for number, episode in enumerate(source.episodes()):
            name = schema.episode_name(number)
            recorded = episode.frames()
            data = [converter.frame(frame) for frame in recorded]
            metadata = converter.metadata(episode, data)
            _write_images(stage.path / name, episode, converter.names, [frame["timestamp"] for frame in recorded])
            _write_frames(stage.path / name, data, metadata)
            if not first:
                first = data[0]
                _write_json(stage.path / schema.SHARED_METADATA, metadata)
            frames[name] = len(data)
            progress(number + 1, len(source))
        total = sum(frames.values())
        size = {"n_seqs": len(frames), "n_samples": len(frames), "n_frames": total}
        _write_json(stage.path / schema.SPLIT, {"filters": {}, "size": size, "files": frames})
        _write_json(stage.path / schema.CALIBRATION, converter.calibration(first))
    return Exported(out, len(frames), total, stage.moved_aside)


class _Converter:
    """Turns frames of one dataset into those of the real stack.

    Attributes:
        names: camera -> its name there.
    """

    def __init__(self, source: Source, locations: Locations) -> None:
        arm = source.config.rig.arms[0]
        self._cameras = source.cameras
        self._wrist = arm.wrist_camera_name if source.config.wrist else None
        self.names = {name: _LEFT_WRIST_CAMERA if name == self._wrist else name for name in source.cameras}
        self._kinematics = ArmKinematics(bare_arm(arm, locations))
        self._opening = load_limits(arm.model, locations).fingers[arm.gripper][1]
        self._still = np.zeros(7)
        self._framerate = 1 / source.frame_period

    def frame(self, frame: Mapping[str, Any]) -> dict[str, Any]:
        """A frame's dictionary, as `raiden_schema.LOWDIM` has it."""
        joints, command = self._shared(frame["joints"]), self._shared(frame["action_joints"])
        return {
            "intrinsics": {self.names[camera]: frame["intrinsics"][camera] for camera in self.names},
            "extrinsics": {self.names[camera]: frame["extrinsics"][camera] for camera in self.names},
            "joints": _f32([joints, self._still]),
            "action": _f32([self._hand(command), self._hand(self._still)]),
            "actual_poses": _f32([self._hand(joints), self._hand(self._still)]),
            "action_joints": _f32([command, self._still]),
            "language_task": frame["language_task"],
            "language_prompt": frame["language_prompt"],
        }

    def _shared(self, joints: ArrayLike) -> Array:
        """Six joints, and the gripper as a share of its opening."""
        values = np.array(joints, dtype=np.float64)
        values[6] = np.clip(values[6] / self._opening, 0.0, 1.0)
        return values

    def _hand(self, joints: Array) -> Array:
        T = self._kinematics.T_grasp_in_base(joints[:6])
        return np.concatenate([T[:3, 3], T[:3, :3].ravel(), joints[6:]])

    def metadata(self, episode: StoredEpisode, frames: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """What `metadata.json` holds."""
        sizes = {self.names[camera]: [height, width] for camera, (width, height) in episode.record.cameras.items()}
        one_size = len({tuple(size) for size in sizes.values()}) == 1
        depth = bool(depth_cameras(episode))
        return {
            "info": {
                "name": frames[0]["language_task"],
                "raw_id": f"{episode.dataset.name}/{episode.directory.name}",
                "tags": ["robotics"],
            },
            "labels": ["rgb", *(["depth"] if depth else []), "action", "language"],
            "cameras": list(sizes),
            "resolution": next(iter(sizes.values())) if one_size else sizes,
            "framerate": self._framerate,
            "language": {"task": frames[0]["language_task"], "prompt": [frames[0]["language_prompt"]]},
            "num_frames": len(frames),
            "rgb": {"extension": "jpg"},
            **({"depth": {"extension": "npz", "sparse": False, "metric": True}} if depth else {}),
            "intrinsics": {"model": "pinhole"},
            "extrinsics": {"transform": "cam2world", "metric": True},
            "action": {"format": "joint_cmd", "dims": 14},
        }

    def calibration(self, frame: Mapping[str, Any]) -> dict[str, Any]:
        """What `calibration_results.json` holds: the cameras as they are in a frame of the real stack's kind."""
        return {
            "version": "1.0",
            "timestamp": _ZERO_TIME,
            "coordinate_frame": "left_arm_base",
            "cameras": {
                self.names[camera]: self._calibrated(camera, size, frame) for camera, size in self._cameras.items()
            },
        }

    def _calibrated(self, camera: str, size: tuple[int, int], frame: Mapping[str, Any]) -> dict[str, Any]:
        name = self.names[camera]
        T = np.asarray(frame["extrinsics"][name], dtype=np.float64)
        intrinsics = {
            "camera_matrix": frame["intrinsics"][name].tolist(),
            "distortion_coeffs": [0.0] * 5,
            "image_size": list(size),
            "source": "simulation",
        }
        entry = {"serial_number": 0, "intrinsics": intrinsics, "num_poses_used": 0}
        if camera != self._wrist:
            return {"type": "scene", **entry, "extrinsics": {**_transform(T), "reference_frame": "left_arm_base"}}
        hand = self._kinematics.T_grasp_in_base(frame["joints"][:6])
        return {"type": "hand_eye", **entry, "hand_eye_calibration": {**_transform(inverse(hand) @ T), "method": "sim"}}


def _f32(arms: Sequence[ArrayLike]) -> NDArray[np.float32]:
    return np.concatenate(arms).astype(np.float32)


def _transform(T: Array) -> dict[str, Any]:
    return {
        "success": True,
        "rotation_matrix": T[:3, :3].tolist(),
        "translation_vector": T[:3, 3].tolist(),
        "rotation_vector": rotation_vector(T[:3, :3]).tolist(),
    }


def _write_images(folder: Path, episode: StoredEpisode, names: Mapping[str, str], timestamps: Sequence[float]) -> None:
    """Colour and depth of all cameras, and when each frame was taken (s)."""
    with_depth = depth_cameras(episode)
    nanoseconds = _npy(np.array([round(time * 1e9) for time in timestamps], dtype=schema.TIMESTAMPS.dtype))
    for camera, name in names.items():
        rgb, depth = folder / "rgb" / name, folder / "depth" / name
        rgb.mkdir(parents=True)
        (rgb / schema.TIMESTAMPS_FILE).write_bytes(nanoseconds)
        for k in range(len(timestamps)):
            (rgb / schema.frame_name(k, "jpg")).write_bytes(episode.image(camera, k))
        if camera in with_depth:
            depth.mkdir(parents=True)
            for k in range(len(timestamps)):
                (depth / schema.frame_name(k, "npz")).write_bytes(_depth(episode, camera, k))


def _write_frames(folder: Path, data: Sequence[Mapping[str, Any]], metadata: Mapping[str, Any]) -> None:
    (folder / "lowdim").mkdir()
    for k, frame in enumerate(data):
        (folder / "lowdim" / schema.frame_name(k, "pkl")).write_bytes(dump_frame(frame))
    _write_json(folder / schema.METADATA, metadata)


def _depth(episode: StoredEpisode, camera: str, number: int) -> bytes:
    """A depth image's file as it is, once it was seen to hold what it should."""
    name = depth_name(camera, number)
    data = episode.whole(name)
    width, height = episode.record.cameras[camera]
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            depth = archive[schema.DEPTH_KEY]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{episode.directory / name} holds no array {schema.DEPTH_KEY!r}: {error}") from error
    if depth.dtype != schema.DEPTH.dtype or depth.shape != (height, width):
        raise DatasetError(
            f"{episode.directory / name}: depth is {depth.dtype} {depth.shape}, not {schema.DEPTH.dtype} "
            f"{(height, width)}"
        )
    return data


def _npy(array: NDArray[np.int64]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
