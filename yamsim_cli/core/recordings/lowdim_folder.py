"""Recordings with `rgb/` and `lowdim/`: the lab's own, and what raiden's converter writes.

A frame's pickle has `joints` and perhaps `action_joints` (7,) or (14,), the left arm first, each arm's gripper last.
raiden has grippers as shares, and times in `rgb/<camera>/timestamps.npy`, ns; the lab has metres, and `timestamp`, s.
Source: TRI-ML/raiden 2353b10, `converter.py`.
"""

from __future__ import annotations

import functools
import io
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..config.real import GripperUnit
from ..config.rig import RigConfig
from ..dataset.lowdim import load_frame
from ..errors import DatasetError, ResourceError
from ..geometry.se3 import Array
from ..images.image_files import read_image
from ..images.jpeg import encode_jpeg
from ..motion import ArmMotion, Motion
from .columns import sides
from .metadata import METADATA, problems_of, prompt_of
from .recording import Pictures, Recording
from .times import from_nanoseconds, from_seconds

_JPEG = (".jpg", ".jpeg")
_PICTURES = (*_JPEG, ".png")
# Of pictures that were no JPEG: hardly any loss.
_QUALITY = 95
_TIMESTAMPS = "timestamps.npy"
_MOST_BYTES = 1 << 20


def read_lowdim(path: Path, rig: RigConfig) -> list[Recording]:
    """The recordings in a folder: itself, or those of the folders in it.

    Raises:
        DatasetError: there is none, or one is damaged or of another rig.
    """
    folders = (
        [path] if (path / "lowdim").is_dir() else sorted(one for one in path.iterdir() if (one / "lowdim").is_dir())
    )
    if not folders:
        raise DatasetError(
            f"{path}: holds no lowdim/, nor does a folder in it; give an episode or a folder of episodes"
        )
    return [_recording(folder, rig) for folder in folders]


def _recording(folder: Path, rig: RigConfig) -> Recording:
    files = _numbered(folder / "lowdim", (".pkl",))
    if len(files) < 2:
        raise DatasetError(f"{folder}/lowdim: holds {len(files)} frames; a motion needs two at least")
    frames = [_frame(file) for file in files]
    cameras = _cameras(folder, len(frames))
    times = _times(folder, frames, cameras)
    joints = _rows(frames, "joints", files, rig)
    told = _rows(frames, "action_joints", files, rig) if "action_joints" in frames[0] else None
    arms = tuple(_arm(side, k, joints, told, rig) for k, side in enumerate(sides(rig)))
    said = next((text for key in ("language_prompt", "language_task") if (text := _text(frames[0].get(key)))), "")
    return Recording(
        Motion(str(folder), times, arms),
        _unit(folder, joints, rig),
        {
            name: Pictures(np.arange(len(times), dtype=np.int64), functools.partial(_jpegs, found))
            for name, found in cameras.items()
        },
        said or prompt_of(folder),
        {name: K for name in cameras if (K := _matrix(frames[0], "intrinsics", name, 3)) is not None},
        {name: T for name in cameras if (T := _poses(frames, name)) is not None},
        problems_of(folder, len(files)),
    )


def _text(value: object) -> str:
    """A text, or the first of an array of them; empty where there is none."""
    texts = np.asarray("" if value is None else value).ravel()
    return str(texts[0]) if len(texts) and texts.dtype.kind == "U" else ""


def _numbered(folder: Path, endings: Sequence[str]) -> list[Path]:
    """Files that are numbers, in their order; without a gap.

    Raises:
        DatasetError: a number is missing.
    """
    files = sorted(
        (file for file in folder.iterdir() if file.suffix.lower() in endings and file.stem.isdecimal()),
        key=lambda file: int(file.stem),
    )
    for file, following in itertools.pairwise(files):
        if int(following.stem) != int(file.stem) + 1:
            raise DatasetError(f"{folder}: {following.name} follows {file.name}: frames between them are missing")
    return files


def _frame(file: Path) -> dict[str, Any]:
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise DatasetError(f"{file}: has {file.stat().st_size} bytes; a frame has at most {_MOST_BYTES}")
        return load_frame(file.read_bytes())
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from error
    except DatasetError as error:
        raise DatasetError(str(error) if str(error).startswith(str(file)) else f"{file}: {error}") from error


def _rows(frames: Sequence[dict[str, Any]], key: str, files: Sequence[Path], rig: RigConfig) -> Array:
    """One row of all drives a frame, (n, arms, drives)."""
    arms, drives = len(rig.arms), rig.drives
    rows = []
    for frame, file in zip(frames, files, strict=True):
        try:
            row = np.asarray(frame[key], dtype=np.float64).ravel()
        except (KeyError, TypeError, ValueError):
            raise DatasetError(f"{file}: has no numbers under {key!r}, but {', '.join(map(str, frame))}") from None
        if arms == 1 and len(row) == 2 * drives:
            # A station's file has room for both arms; a lone one is the left.
            row = row[:drives] if rig.arms[0].side == "left" or not np.any(row[drives:]) else row[drives:]
        if len(row) != arms * drives or not np.isfinite(row).all():
            raise DatasetError(
                f"{file}: {key} has {len(row)} numbers, {np.count_nonzero(np.isfinite(row))} of them finite; rig "
                f"{rig.name!r} needs {arms * drives}"
            )
        rows.append(row.reshape(arms, drives))
    return np.array(rows)


def _arm(side: str, k: int, joints: Array, told: Array | None, rig: RigConfig) -> ArmMotion:
    robot = rig.arms[rig.recorded[k]].robot
    dof = robot.dof
    with_fingers = robot.fingers is not None
    return ArmMotion(
        side,
        joints[:, k, :dof],
        None if told is None else told[:, k, :dof],
        joints[:, k, dof] if with_fingers else None,
        told[:, k, dof] if with_fingers and told is not None else None,
    )


def _unit(folder: Path, joints: Array, rig: RigConfig) -> GripperUnit:
    """Shares where raiden's converter was at work, and where openings are wider than fingers go."""
    fingers = [rig.arms[k].robot.fingers for k in rig.recorded]
    widest = max((one.range[1] for one in fingers if one), default=0.0)
    return "share" if (folder / METADATA).exists() or joints[..., -1].max() > 1.5 * widest else "metres"


def _cameras(folder: Path, frames: int) -> dict[str, list[Path]]:
    """Camera -> a picture for each frame."""
    found: dict[str, list[Path]] = {}
    for camera in sorted((folder / "rgb").iterdir()) if (folder / "rgb").is_dir() else []:
        files = _numbered(camera, _PICTURES) if camera.is_dir() else []
        if files and len(files) != frames:
            raise DatasetError(f"{camera}: has {len(files)} pictures, and lowdim/ {frames} frames; was it cut off?")
        if files:
            found[camera.name] = files
    return found


def _times(folder: Path, frames: Sequence[dict[str, Any]], cameras: dict[str, list[Path]]) -> Array:
    if all("timestamp" in frame for frame in frames):
        return from_seconds(np.array([float(frame["timestamp"]) for frame in frames]), str(folder))
    for camera in cameras:
        file = folder / "rgb" / camera / _TIMESTAMPS
        if not file.is_file():
            continue
        try:
            with io.BytesIO(file.read_bytes()) as stream:
                stamps = np.lib.format.read_array(stream, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise DatasetError(f"{file} cannot be read: {error}") from error
        if len(stamps) != len(frames):
            raise DatasetError(f"{file}: has {len(stamps)} times, and lowdim/ {len(frames)} frames; was it cut off?")
        return from_nanoseconds(stamps, str(file))
    raise DatasetError(f"{folder}: has no times, neither `timestamp` in lowdim/ nor rgb/<camera>/{_TIMESTAMPS}")


def _matrix(frame: dict[str, Any], key: str, camera: str, side: int) -> Array | None:
    held = frame.get(key)
    values = held.get(camera) if isinstance(held, dict) else None
    if values is None:
        return None
    matrix = np.asarray(values, dtype=np.float64)
    return matrix if matrix.shape == (side, side) and np.isfinite(matrix).all() else None


def _poses(frames: Sequence[dict[str, Any]], camera: str) -> Array | None:
    """A camera's poses (n, 4, 4); None where they are not known, for which raiden's converter writes the identity."""
    poses = [_matrix(frame, "extrinsics", camera, 4) for frame in frames]
    known = np.array([T for T in poses if T is not None])
    return known if len(known) == len(frames) and np.any(known != np.eye(4)) else None


def _jpegs(files: Sequence[Path]) -> Iterator[bytes]:
    """The pictures as JPEG: as they are, where they are that."""
    for file in files:
        try:
            if file.suffix.lower() in _JPEG:
                yield file.read_bytes()
            else:
                yield encode_jpeg(read_image(file), _QUALITY)
        except (OSError, ResourceError) as error:
            raise DatasetError(f"{file} cannot be read: {error}") from error
