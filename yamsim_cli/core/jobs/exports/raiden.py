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
from ...config.rig import ArmConfig
from ...dataset.layout import depth_name
from ...dataset.lowdim import BETWEEN_BASES, dump_frame
from ...dataset.reader import StoredEpisode
from ...errors import DatasetError
from ...geometry.se3 import Array, inverse, rotation_vector
from ...planning.kinematics import ArmKinematics
from ...resources import Locations
from ...scene.robot import bare_arm
from . import raiden_schema as schema
from .source import Exported, Progress, Source, depth_cameras
from .target import export_directory

# Of the arms in order: a lone arm is the left one, and so is its camera.
_WRIST_CAMERAS = ("left_wrist_camera", "right_wrist_camera")

_ZERO_TIME = "1970-01-01T00:00:00.000000"


def export_raiden(
    source: Source, out: Path, locations: Locations, progress: Progress, *, overwrite: bool = False
) -> Exported:
    """Write a dataset in the real stack's layout; images and depth byte for byte as they are.

    The global frame is the base of the left arm. A lone arm is the left one; the right one is still, with all joints 0.
    Grippers are a share of the opening, 0 closed and 1 open, as the real arm's drive reports them.

    Raises:
        DatasetError: a file is missing, altered or damaged.
        UsageError, PartialJobError, InterruptedJobError: see `export_directory`.
    """
    converter = _Converter(source, locations)
    frames: dict[str, int] = {}
    with export_directory(out, overwrite=overwrite) as stage:
        calibration: dict[str, Any] = {}
        for number, episode in enumerate(source.episodes()):
            name = schema.episode_name(number)
            recorded = episode.frames()
            data = [converter.frame(frame) for frame in recorded]
            metadata = converter.metadata(episode, data)
            _write_images(stage.path / name, episode, converter.names, [frame["timestamp"] for frame in recorded])
            _write_frames(stage.path / name, data, metadata)
            if not calibration:
                calibration = converter.calibration(data[0], recorded[0].get(BETWEEN_BASES))
                _write_json(stage.path / schema.SHARED_METADATA, metadata)
            frames[name] = len(data)
            progress(number + 1, len(source))
        total = sum(frames.values())
        size = {"n_seqs": len(frames), "n_samples": len(frames), "n_frames": total}
        _write_json(stage.path / schema.SPLIT, {"filters": {}, "size": size, "files": frames})
        _write_json(stage.path / schema.CALIBRATION, calibration)
    return Exported(out, len(frames), total, stage.moved_aside)


class _Arm:
    """What the real stack tells of an arm, from recorded joints (7,): six in rad, and one finger's opening in m."""

    def __init__(self, arm: ArmConfig, locations: Locations) -> None:
        self._kinematics = ArmKinematics(bare_arm(arm, locations))
        self._opening = load_limits(arm.model, locations).fingers[arm.gripper][1]

    def shared(self, joints: ArrayLike) -> Array:
        """Six joints, and the gripper as a share of its opening."""
        values = np.array(joints, dtype=np.float64)
        values[6] = np.clip(values[6] / self._opening, 0.0, 1.0)
        return values

    def hand(self, shared: Array) -> Array:
        """The hand's position, its rotation row by row and the gripper (13,), in this arm's base."""
        T = self.T_hand_in_base(shared)
        return np.concatenate([T[:3, 3], T[:3, :3].ravel(), shared[6:]])

    def T_hand_in_base(self, joints: ArrayLike) -> Array:
        """The hand's pose (4, 4) in this arm's base, by kinematics."""
        return self._kinematics.T_grasp_in_base(np.asarray(joints)[:6])


class _Converter:
    """Turns frames of one dataset into those of the real stack.

    Attributes:
        names: camera -> its name there.
    """

    def __init__(self, source: Source, locations: Locations) -> None:
        config = source.config
        arms = [config.rig.arms[k] for k in config.rig.recorded]
        self._cameras = source.cameras
        # Wrist camera -> its arm's place.
        self._wrists = {arm.wrist_camera_name: k for k, arm in enumerate(arms) if arm in config.wrist_arms}
        self.names = {
            name: _WRIST_CAMERAS[self._wrists[name]] if name in self._wrists else name for name in self._cameras
        }
        # Where there is one alone, the other is like it.
        self._arms = [_Arm(arm, locations) for arm in (arms[0], arms[-1])]
        self._framerate = 1 / source.frame_period

    def frame(self, frame: Mapping[str, Any]) -> dict[str, Any]:
        """A frame's dictionary, as `raiden_schema.LOWDIM` has it."""
        joints, command = self._shared(frame["joints"]), self._shared(frame["action_joints"])
        return {
            "intrinsics": {self.names[camera]: frame["intrinsics"][camera] for camera in self.names},
            "extrinsics": {self.names[camera]: frame["extrinsics"][camera] for camera in self.names},
            "joints": _f32(joints),
            "action": _f32(self._hands(command)),
            "actual_poses": _f32(self._hands(joints)),
            "action_joints": _f32(command),
            "language_task": frame["language_task"],
            "language_prompt": frame["language_prompt"],
        }

    def _shared(self, joints: ArrayLike) -> list[Array]:
        """Each arm's joints (7,), of recorded ones (7,) or (14,)."""
        rows = np.zeros((2, 7))
        recorded = np.reshape(joints, (-1, 7))
        rows[: len(recorded)] = recorded
        return [arm.shared(row) for arm, row in zip(self._arms, rows, strict=True)]

    def _hands(self, shared: Sequence[Array]) -> list[Array]:
        return [arm.hand(row) for arm, row in zip(self._arms, shared, strict=True)]

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

    def calibration(self, frame: Mapping[str, Any], T_right_base_in_left_base: ArrayLike | None) -> dict[str, Any]:
        """What `calibration_results.json` holds: the cameras as they are in a frame of the real stack's kind.

        Args:
            T_right_base_in_left_base: pose (4, 4), of two arms.
        """
        between = None if T_right_base_in_left_base is None else np.asarray(T_right_base_in_left_base, np.float64)
        return {
            "version": "1.0",
            "timestamp": _ZERO_TIME,
            "coordinate_frame": "left_arm_base",
            "cameras": {
                self.names[camera]: self._calibrated(camera, size, frame, between)
                for camera, size in self._cameras.items()
            },
            **({} if between is None else {"bimanual_transform": _bimanual(between)}),
        }

    def _calibrated(
        self, camera: str, size: tuple[int, int], frame: Mapping[str, Any], T_right_base_in_left_base: Array | None
    ) -> dict[str, Any]:
        name = self.names[camera]
        T = np.asarray(frame["extrinsics"][name], dtype=np.float64)
        intrinsics = {
            "camera_matrix": frame["intrinsics"][name].tolist(),
            "distortion_coeffs": [0.0] * 5,
            "image_size": list(size),
            "source": "simulation",
        }
        entry = {"serial_number": 0, "intrinsics": intrinsics, "num_poses_used": 0}
        if camera not in self._wrists:
            return {"type": "scene", **entry, "extrinsics": {**_transform(T), "reference_frame": "left_arm_base"}}
        arm = self._wrists[camera]
        hand = self._arms[arm].T_hand_in_base(frame["joints"][7 * arm :])
        if arm == 1 and T_right_base_in_left_base is not None:
            hand = T_right_base_in_left_base @ hand
        return {"type": "hand_eye", **entry, "hand_eye_calibration": {**_transform(inverse(hand) @ T), "method": "sim"}}


def _bimanual(T_right_base_in_left_base: Array) -> dict[str, Any]:
    """Where the arms stand. Source: TRI-ML/raiden, `converter.py`: it inverts what it reads, whatever the key says."""
    return {
        "right_base_to_left_base": inverse(T_right_base_in_left_base).tolist(),
        "computed_from_calibration": False,
        "description": "Pose of the left arm's base in the right one's: the inverse of T_right_base_in_left_base",
        BETWEEN_BASES: T_right_base_in_left_base.tolist(),
    }


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
