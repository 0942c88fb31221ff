"""Read recordings of raiden and the lab's fork: raw `robot_data.npz`, and folders with `rgb/` and `lowdim/`.

A raw recording has `timestamps` in ns at about 100 Hz, and `follower_l_joint_pos_7d` and `follower_l_joint_cmd` (n, 7):
six joints in rad and the gripper, 0 (closed) to 1 (open). `follower_r` has the same keys.

A folder's frame is a pickle with `joints` and optional `action_joints` (7,) or (14,), left arm first, each gripper
last. raiden's converter writes grippers as shares, and times to `rgb/<camera>/timestamps.npy`, ns; the lab's fork
writes metres, and `timestamp`, s.

Source: TRI-ML/raiden 2353b10, `recorder.py` and `converter.py`.
"""

from __future__ import annotations

import functools
import io
import itertools
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.config.real_recordings import GripperUnit
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.errors import DatasetError, ResourceError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image_files import read_image
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.recorded_motion import RecordedMotion

from .recording import (
    JPEG_QUALITY,
    CameraImages,
    Recording,
    motion_sides,
    split_arms,
    times_from_nanoseconds,
    times_from_seconds,
)

ROBOT_DATA = "robot_data.npz"

_FOLLOWER_PREFIXES = {"left": "follower_l", "right": "follower_r"}  # side -> prefix in a raw recording
_METADATA_FILE = "metadata.json"
_TIMESTAMPS_FILE = "timestamps.npy"
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_PICTURE_SUFFIXES = (*_JPEG_SUFFIXES, ".png")
_MAX_RAW_BYTES = 1 << 30  # a larger file is no recording of one task
_MAX_FRAME_BYTES = 1 << 20
_MIN_SHARE_RATIO = 1.5  # multiple of the fingers' range; larger openings are shares, not metres


def read_raiden_raw(path: Path, rig: RigConfig) -> list[Recording]:
    """Read the one recording of a `robot_data.npz`, or of its folder, without videos.

    Raises:
        DatasetError: the file cannot be read, is damaged, or lacks an arm of the rig.
    """
    file = path / ROBOT_DATA if path.is_dir() else path
    try:
        with np.load(file, allow_pickle=False) as data:
            if sum(entry.file_size for entry in data.zip.infolist()) > _MAX_RAW_BYTES:
                raise DatasetError(f"{file}: holds more than {_MAX_RAW_BYTES / 1e9:.1f} GB, too much for one task")
            arrays = {name: data[name] for name in data.files if name == "timestamps" or name.startswith("follower_")}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise DatasetError(f"{file} cannot be read: {error}; copy it again") from error
    if "timestamps" not in arrays:
        raise DatasetError(
            f"{file}: has no timestamps; it has {', '.join(sorted(arrays)) or 'nothing'}: raiden writes timestamps"
        )
    times = times_from_nanoseconds(np.asarray(arrays["timestamps"]), str(file))
    followers = [_follower_prefix(side, arrays, file) for side in motion_sides(rig)]
    joints, commands = (
        np.stack(
            [_raw_rows(arrays, f"{name}_{key}", (len(times), rig.drive_count), file) for name in followers], axis=1
        )
        for key in ("joint_pos_7d", "joint_cmd")
    )
    speeds = [arrays.get(f"{name}_joint_vel") for name in followers]
    velocities = [np.asarray(rows, dtype=np.float64) for rows in speeds if rows is not None]
    known = np.stack(velocities, axis=1) if len(velocities) == len(followers) else None
    motion = RecordedMotion(str(file), times, split_arms(joints, commands, rig, known))
    return [Recording(motion, "share", prompt=_read_prompt(file.parent), problems=_metadata_problems(file.parent))]


def _follower_prefix(side: str, arrays: Mapping[str, NDArray[np.generic]], file: Path) -> str:
    if side:
        return _FOLLOWER_PREFIXES[side]
    recorded = [name for name in _FOLLOWER_PREFIXES.values() if f"{name}_joint_pos_7d" in arrays]
    if len(recorded) != 1:
        raise DatasetError(
            f"{file}: holds {len(recorded)} followers, and the rig has one arm; give a --rig with as many arms"
        )
    return recorded[0]


def _raw_rows(arrays: Mapping[str, NDArray[np.generic]], key: str, shape: tuple[int, int], file: Path) -> Array:
    if key not in arrays:
        raise DatasetError(f"{file}: has no {key}; it holds {', '.join(sorted(arrays))}; give a --rig with its arms")
    rows = np.asarray(arrays[key], dtype=np.float64)
    if rows.shape != shape:
        raise DatasetError(
            f"{file}: {key} has the shape {rows.shape}; valid: {shape}; it was probably cut off: copy it again, or "
            "leave it out"
        )
    if not np.isfinite(rows).all():
        at = int(np.argwhere(~np.isfinite(rows))[0, 0])
        raise DatasetError(f"{file}: {key} is not finite at sample {at}; remove the sample")
    return rows


def read_lowdim(path: Path, rig: RigConfig) -> list[Recording]:
    """Read recordings with `lowdim/` and `rgb/`, in the folder or its subfolders.

    Raises:
        DatasetError: the folder has no recording, or one is damaged or does not fit the rig.
    """
    folders = (
        [path] if (path / "lowdim").is_dir() else sorted(one for one in path.iterdir() if (one / "lowdim").is_dir())
    )
    if not folders:
        raise DatasetError(
            f"{path}: neither this folder nor a folder in it contains lowdim/; give an episode or a folder of episodes"
        )
    return [_lowdim_recording(folder, rig) for folder in folders]


def _lowdim_recording(folder: Path, rig: RigConfig) -> Recording:
    files = _numbered_files(folder / "lowdim", (".pkl",))
    if len(files) < 2:
        raise DatasetError(f"{folder}/lowdim: holds {len(files)} frames; a motion needs at least two")
    frames = [_load_frame_file(file) for file in files]
    cameras = _camera_files(folder, len(frames))
    times = _frame_times(folder, frames, cameras)
    joints = _frame_rows(frames, "joints", files, rig)
    commands = _frame_rows(frames, "action_joints", files, rig) if "action_joints" in frames[0] else None
    texts = [_text_from_array(frames[0].get(key)) for key in ("language_prompt", "language_task")]
    samples = np.arange(len(times), dtype=np.int64)
    return Recording(
        RecordedMotion(str(folder), times, split_arms(joints, commands, rig)),
        _gripper_unit(folder, joints, rig),
        {name: CameraImages(samples, functools.partial(_read_jpegs, found)) for name, found in cameras.items()},
        next(filter(None, texts), "") or _read_prompt(folder),
        {name: K for name in cameras if (K := _camera_matrix(frames[0], "intrinsics", name, 3)) is not None},
        {name: T for name in cameras if (T := _camera_poses(frames, name)) is not None},
        _metadata_problems(folder, len(files)),
    )


def _text_from_array(value: object) -> str:
    texts = np.asarray("" if value is None else value).ravel()
    return str(texts[0]) if len(texts) and texts.dtype.kind == "U" else ""


def _numbered_files(folder: Path, endings: Sequence[str]) -> list[Path]:
    """Return files named by numbers, in order. A missing number raises a DatasetError."""
    files = sorted(
        (file for file in folder.iterdir() if file.suffix.lower() in endings and file.stem.isdecimal()),
        key=lambda file: int(file.stem),
    )
    for file, following in itertools.pairwise(files):
        if int(following.stem) != int(file.stem) + 1:
            raise DatasetError(f"{folder}: {following.name} follows {file.name}: frames between them are missing")
    return files


def _load_frame_file(file: Path) -> dict[str, Any]:
    try:
        if file.stat().st_size > _MAX_FRAME_BYTES:
            raise DatasetError(f"has {file.stat().st_size} bytes; a frame has at most {_MAX_FRAME_BYTES}")
        return load_frame(file.read_bytes())
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from error
    except DatasetError as error:
        raise DatasetError(f"{file}: {error}") from error


def _frame_rows(frames: Sequence[dict[str, Any]], key: str, files: Sequence[Path], rig: RigConfig) -> Array:
    arms, drives = len(rig.arms), rig.drive_count
    rows = []
    for frame, file in zip(frames, files, strict=True):
        try:
            row = np.asarray(frame[key], dtype=np.float64).ravel()
        except (KeyError, TypeError, ValueError):
            raise DatasetError(
                f"{file}: has no numbers under {key!r}; its keys are {', '.join(map(str, frame))}"
            ) from None
        if arms == 1 and len(row) == 2 * drives:
            # Two arms, but the rig has one: an arm that is not on the left takes the left half only if the right is 0.
            row = row[:drives] if rig.arms[0].side == "left" or not np.any(row[drives:]) else row[drives:]
        if len(row) != arms * drives or not np.isfinite(row).all():
            raise DatasetError(
                f"{file}: {key} has {len(row)} numbers, {np.count_nonzero(np.isfinite(row))} of them finite; rig "
                f"{rig.name!r} needs {arms * drives}"
            )
        rows.append(row.reshape(arms, drives))
    return np.array(rows)


def _gripper_unit(folder: Path, joints: Array, rig: RigConfig) -> GripperUnit:
    """Return `share` if raiden's converter wrote the folder or openings exceed the range, else `metres`."""
    fingers = [rig.arms[k].robot.fingers for k in rig.recording_order]
    widest = max((one.range[1] for one in fingers if one), default=0.0)
    return (
        "share" if (folder / _METADATA_FILE).exists() or joints[..., -1].max() > _MIN_SHARE_RATIO * widest else "metres"
    )


def _camera_files(folder: Path, frames: int) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {}
    for camera in sorted((folder / "rgb").iterdir()) if (folder / "rgb").is_dir() else []:
        files = _numbered_files(camera, _PICTURE_SUFFIXES) if camera.is_dir() else []
        if files and len(files) != frames:
            raise DatasetError(
                f"{camera}: has {len(files)} images, and lowdim/ has {frames} frames; it was probably cut off: copy "
                "it again, or leave it out"
            )
        if files:
            found[camera.name] = files
    return found


def _frame_times(folder: Path, frames: Sequence[dict[str, Any]], cameras: Mapping[str, list[Path]]) -> Array:
    if all("timestamp" in frame for frame in frames):
        return times_from_seconds(np.array([float(frame["timestamp"]) for frame in frames]), str(folder))
    for camera in cameras:
        file = folder / "rgb" / camera / _TIMESTAMPS_FILE
        if not file.is_file():
            continue
        try:
            with io.BytesIO(file.read_bytes()) as stream:
                stamps = np.lib.format.read_array(stream, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise DatasetError(f"{file} cannot be read: {error}") from error
        if len(stamps) != len(frames):
            raise DatasetError(
                f"{file}: has {len(stamps)} times, and lowdim/ has {len(frames)} frames; it was probably cut off: "
                "copy it again, or leave it out"
            )
        return times_from_nanoseconds(stamps, str(file))
    raise DatasetError(f"{folder}: has no times, neither `timestamp` in lowdim/ nor rgb/<camera>/{_TIMESTAMPS_FILE}")


def _camera_matrix(frame: dict[str, Any], key: str, camera: str, side: int) -> Array | None:
    matrices = frame.get(key)
    values = matrices.get(camera) if isinstance(matrices, dict) else None
    if values is None:
        return None
    matrix = np.asarray(values, dtype=np.float64)
    return matrix if matrix.shape == (side, side) and np.isfinite(matrix).all() else None


def _camera_poses(frames: Sequence[dict[str, Any]], camera: str) -> Array | None:
    """Return a camera's poses (n, 4, 4), if all frames have one.

    raiden's converter writes identities for unknown poses.
    """
    poses = [_camera_matrix(frame, "extrinsics", camera, 4) for frame in frames]
    known = np.array([T for T in poses if T is not None])
    return known if len(known) == len(frames) and np.any(known != np.eye(4)) else None


def _read_jpegs(files: Sequence[Path]) -> Iterator[bytes]:
    for file in files:
        try:
            if file.suffix.lower() in _JPEG_SUFFIXES:
                yield file.read_bytes()
            else:
                yield encode_jpeg(read_image(file), JPEG_QUALITY)
        except (OSError, ResourceError) as error:
            raise DatasetError(f"{file} cannot be read: {error}") from error


def _read_prompt(directory: Path) -> str:
    metadata = _read_metadata(directory)
    language = metadata.get("language")
    keys = ("task_instruction", "instruction", "task_name")
    texts = [language.get(key) for key in ("prompt", "task")] if isinstance(language, dict) else []
    return next((text for text in (*texts, *map(metadata.get, keys)) if isinstance(text, str)), "")


def _metadata_problems(directory: Path, frames: int | None = None) -> tuple[str, ...]:
    metadata, file = _read_metadata(directory), directory / _METADATA_FILE
    problems = []
    if metadata.get("complete") is False:
        problems.append(f"{file} says that it is not complete: was the recording cut off?")
    if frames is not None and isinstance(count := metadata.get("num_frames"), int) and count > frames:
        problems.append(f"there are {frames} frames, and {file} says {count}: was it cut off?")
    return tuple(problems)


def _read_metadata(directory: Path) -> dict[str, Any]:
    try:
        content = json.loads((directory / _METADATA_FILE).read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
