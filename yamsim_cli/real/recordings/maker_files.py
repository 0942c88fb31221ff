"""Read episodes of the maker's station program: arrays and an MP4 per camera, in a folder per episode.

Source: i2rt-robotics/yam-abc-reproduce 7d9f9d1, `yam_abc_reproduce/data/schema.py`, `recorder.py`, `default_format.py`.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion

from .recording import CameraImages, Recording, motion_sides, read_json_object, video_jpegs

_METADATA, _COMPLETE_FLAG = "metadata.json", "write_complete.flag"
_RGB = "rgb"  # image key of a camera with one lens; a pair has `left` and `right`
_S_PER_MS = 1e-3
_MAX_RATE = 10_000.0  # control ticks per second, far above the program's 30
_MAX_DEPTH = 3  # folders between a given folder and an episode: policy, task, episode


def maker_folders(path: Path) -> list[Path]:
    """Return a folder itself if it is an episode of the maker's, else the episodes in it."""
    patterns = [f"{'*/' * depth}*-joint_pos.npy" for depth in range(_MAX_DEPTH + 1)]
    return next((found for pattern in patterns if (found := sorted({file.parent for file in path.glob(pattern)}))), [])


def read_maker(path: Path, rig: RigConfig) -> list[Recording]:
    """Return the recordings of an episode's folder, or of a folder of episodes, grouped by tasks or not.

    A sample is a tick of the control loop. The program records no times of ticks: they are the times of the first
    camera's images, or even if that camera has an image for more than one tick.

    Raises:
        DatasetError: an episode is incomplete or damaged, or does not fit the rig.
    """
    folders = maker_folders(path)
    if not folders:
        raise DatasetError(f"{path}: contains no *-joint_pos.npy; give an episode's folder, or a folder of episodes")
    return [_read_episode(folder, rig) for folder in folders]


def _read_episode(folder: Path, rig: RigConfig) -> Recording:
    if not (folder / _COMPLETE_FLAG).exists():
        raise DatasetError(f"{folder}: has no {_COMPLETE_FLAG}, so its recording was cut off: remove the folder")
    metadata = read_json_object(folder / _METADATA)
    names = _arm_names(metadata, rig, folder)
    arms = tuple(
        _arm_motion(folder, name, side, rig.arms[k].robot.dof)
        for name, side, k in zip(names, motion_sides(rig), rig.recording_order, strict=True)
    )
    ticks = len(arms[0].joints)
    if any(len(arm.joints) != ticks for arm in arms):
        raise DatasetError(f"{folder}: its arms have {' and '.join(str(len(arm.joints)) for arm in arms)} samples")
    cameras = _camera_keys(metadata, folder)
    stamps = {role: _camera_times(folder, role, ticks) for role, _ in cameras.values()}
    times, problems = _tick_times(folder, stamps, ticks, metadata)
    count = metadata.get("num_frames")
    if isinstance(count, int) and count != ticks:
        problems = (*problems, f"there are {ticks} frames, and {_METADATA} says {count}: was it cut off?")
    samples = np.arange(ticks, dtype=np.int64)
    pictures = {
        name: CameraImages(samples, functools.partial(video_jpegs, folder / f"{role}-images-{key}.mp4", ticks))
        for name, (role, key) in cameras.items()
    }
    prompt = metadata.get("task_name")
    motion = RecordedMotion(str(folder), times, arms)
    return Recording(motion, "share", pictures, prompt if isinstance(prompt, str) else "", problems=problems)


def _arm_names(metadata: Mapping[str, Any], rig: RigConfig, folder: Path) -> Sequence[str]:
    """Return the recorded arms in the rig's order, left first. A single arm may have any name."""
    names = metadata.get("arm_names", [metadata.get("arm_name", "left")])  # older episodes have `arm_name`
    valid = isinstance(names, list) and all(isinstance(name, str) and name.isidentifier() for name in names)
    sides = motion_sides(rig)
    if not valid or len(names) != len(sides) or (len(sides) > 1 and set(names) != set(sides)):
        wanted = " and ".join(sides) if len(sides) > 1 else "one arm"
        raise DatasetError(
            f"{folder / _METADATA}: arm_names is {str(names)[:80]}, and rig {rig.name!r} has {wanted}; give another "
            "--rig"
        )
    return sides if len(sides) > 1 else names


def _arm_motion(folder: Path, name: str, side: str, dof: int) -> ArmMotion:
    joints = _load_rows(folder / f"{name}-joint_pos.npy", dof)
    ticks = len(joints)
    if ticks < 2:
        raise DatasetError(f"{folder}: has {ticks} samples; a motion needs at least two")
    return ArmMotion(
        side,
        joints,
        _load_rows(folder / f"action-{name}-joint.npy", dof, ticks),
        _load_rows(folder / f"{name}-gripper_pos.npy", 1, ticks)[:, 0],
        _load_rows(folder / f"action-{name}-gripper.npy", 1, ticks)[:, 0],
    )


def _load_rows(file: Path, width: int, count: int | None = None) -> Array:
    """Return the finite numbers (count, width) of an array file."""
    rows = _load_array(file)
    if rows.ndim != 2 or rows.shape[1] != width or (count is not None and len(rows) != count):
        wanted = f"({'n' if count is None else count}, {width})"
        raise DatasetError(
            f"{file}: has the shape {rows.shape}; valid: {wanted}; copy the file again if it was cut off, or give "
            "another --rig"
        )
    return rows


def _load_array(file: Path) -> Array:
    try:
        with io.BytesIO(file.read_bytes()) as stream:
            values = np.lib.format.read_array(stream, allow_pickle=False)
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError) as error:
        raise DatasetError(f"{file} is not a valid array file: {error}; copy it again") from error
    if values.dtype.kind not in "fiu":
        raise DatasetError(f"{file}: has the type {values.dtype}; valid: numbers")
    numbers = values.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise DatasetError(f"{file}: is not finite at sample {int(np.argwhere(~np.isfinite(numbers))[0, 0])}")
    return numbers


def _camera_keys(metadata: Mapping[str, Any], folder: Path) -> dict[str, tuple[str, str]]:
    """Return name -> role and image key of each picture stream."""
    found: dict[str, tuple[str, str]] = {}
    cameras = metadata.get("cameras", [])
    for camera in cameras if isinstance(cameras, list) else []:
        role, keys = (camera.get("role"), camera.get("image_keys")) if isinstance(camera, dict) else (None, None)
        if not isinstance(role, str) or not isinstance(keys, list) or not all(isinstance(key, str) for key in keys):
            raise DatasetError(f"{folder / _METADATA}: a camera is {str(camera)[:80]}; valid: with role and image_keys")
        found |= {role if key == _RGB else f"{role}_{key}": (role, key) for key in keys}
    for name, parts in found.items():
        if not all(part.isidentifier() for part in parts):
            raise DatasetError(f"{folder / _METADATA}: camera {name[:80]!r} is not valid; valid: letters, digits and _")
    return found


def _camera_times(folder: Path, role: str, ticks: int) -> Array:
    file = folder / f"{role}-timestamp.npy"
    stamps = _load_array(file)
    if stamps.shape != (ticks,):
        raise DatasetError(
            f"{file}: has the shape {stamps.shape}; valid: ({ticks},); it was probably cut off: copy it again, or "
            "leave it out"
        )
    return stamps * _S_PER_MS


def _tick_times(
    folder: Path, stamps: Mapping[str, Array], ticks: int, metadata: Mapping[str, Any]
) -> tuple[Array, tuple[str, ...]]:
    """Return the times of the ticks (n,), s from 0, and the cameras' problems."""
    problems = []
    for role, times in stamps.items():
        pauses = np.diff(times)
        if np.any(pauses < 0):
            k = int(np.argmax(pauses < 0))
            raise DatasetError(f"{folder}: the time of {role} goes back after image {k}: images were mixed up")
        if repeats := int(np.count_nonzero(pauses == 0)):
            problems.append(f"{repeats} of {ticks} images of {role} repeat the one before: it is slower than the arms")
    first = next(iter(stamps.values()), None)
    if first is not None and first[-1] > first[0]:
        if np.all(np.diff(first) > 0):
            return first - first[0], tuple(problems)
        return np.linspace(0.0, first[-1] - first[0], ticks), tuple(problems)
    rate = metadata.get("control_hz")
    if not isinstance(rate, int | float) or isinstance(rate, bool) or not 0 < rate <= _MAX_RATE:
        raise DatasetError(f"{folder / _METADATA}: control_hz is {rate!r}; valid: a number above 0, to {_MAX_RATE:g}")
    return np.arange(float(ticks)) / rate, tuple(problems)
