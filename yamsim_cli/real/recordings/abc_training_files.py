"""Read the layout that ABC's trainer reads: rows at 30 Hz, and one video with the cameras above each other.

Source: amazon-far/abc e5e1fbc, `export_mcap.py`, `abc_minimal/train_loop.py`.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import RecordedMotion

from .recording import CameraImages, Recording, read_json_object, split_arms, video_jpegs

_ROWS, _FILM, _METADATA = "states_actions.bin", "combined_camera-images-rgb.mp4", "episode_metadata.json"
_ARM_WIDTH = 7  # six joints, rad, and the gripper, 0 closed to 1 open
_ROW_WIDTH = 4 * _ARM_WIDTH  # states of the left and the right arm, then their actions
_TICK_NS = 33_333_333  # ns between rows, if the metadata has no tick_ns
_CAMERAS = ("top", "left", "right")  # in the video from the top, if the metadata has no cameras
# Names as `import` gives them to the topics of ABC's MCAP files; others become `<name>_camera`.
_NAMES = {"left": "left_wrist_camera", "right": "right_wrist_camera"}


def abc_training_folders(path: Path) -> list[Path]:
    """Return a folder itself if it is an episode in the layout of ABC's trainer, else the episodes in it."""
    return [path] if (path / _ROWS).is_file() else sorted(file.parent for file in path.glob(f"*/{_ROWS}"))


def read_abc_training(path: Path, rig: RigConfig) -> list[Recording]:
    """Return the recordings of an episode's folder, or of a folder of episodes.

    Raises:
        DatasetError: an episode is damaged or does not fit the rig.
    """
    folders = abc_training_folders(path)
    if not folders:
        raise DatasetError(f"{path}: contains no {_ROWS}; give an episode's folder, or a folder of episodes")
    return [_read_episode(folder, rig) for folder in folders]


def _read_episode(folder: Path, rig: RigConfig) -> Recording:
    metadata = read_json_object(folder / _METADATA)
    rows = _read_rows(folder, metadata)
    tick_ns = metadata.get("tick_ns", _TICK_NS)
    if not isinstance(tick_ns, int) or not 0 < tick_ns < 10**9:
        raise DatasetError(f"{folder / _METADATA}: tick_ns is {tick_ns!r}; valid: a whole number from 1 to 1e9, ns")
    by_arm = rows.reshape(len(rows), 2, 2, _ARM_WIDTH)  # state or action, arm
    used = _used_arms(by_arm, rig, folder)
    arms = split_arms(by_arm[:, 0, used], by_arm[:, 1, used], rig)
    cameras = metadata.get("cameras", list(_CAMERAS))
    if not isinstance(cameras, list) or not all(isinstance(name, str) and name.isidentifier() for name in cameras):
        raise DatasetError(f"{folder / _METADATA}: cameras is {str(cameras)[:80]}; valid: a list of names")
    samples = np.arange(len(rows), dtype=np.int64)
    times = np.arange(float(len(rows))) * (tick_ns * 1e-9)
    pictures = {
        _NAMES.get(name, f"{name}_camera"): CameraImages(
            samples, functools.partial(video_jpegs, folder / _FILM, len(rows), k, len(cameras))
        )
        for k, name in enumerate(cameras)
    }
    task = metadata.get("task_name")
    motion = RecordedMotion(str(folder), times, arms)
    return Recording(motion, "share", pictures, task.replace("_", " ") if isinstance(task, str) else "")


def _read_rows(folder: Path, metadata: Mapping[str, Any]) -> Array:
    file = folder / _ROWS
    try:
        values = np.fromfile(file, dtype=np.float64)
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from error
    count, rest = divmod(len(values), _ROW_WIDTH)
    stated = metadata.get("num_steps", count)
    if rest or count < 2 or stated != count:
        raise DatasetError(
            f"{file}: has {len(values)} numbers, {count} rows of {_ROW_WIDTH} and {rest} more, and {_METADATA} says "
            f"{stated} rows; a motion needs at least two; copy it again"
        )
    if not np.isfinite(values).all():
        at = int(np.argwhere(~np.isfinite(values))[0, 0]) // _ROW_WIDTH
        raise DatasetError(f"{file}: row {at} is not finite")
    return values.reshape(count, _ROW_WIDTH)


def _used_arms(by_arm: Array, rig: RigConfig, folder: Path) -> slice:
    """Return the arms that the rig has. Of a single arm, the other's values are 0."""
    if rig.arms[0].robot.dof + 1 != _ARM_WIDTH:
        raise DatasetError(
            f"{folder}: has arms with {_ARM_WIDTH - 1} joints and a gripper; rig {rig.name!r} has others; give another "
            "--rig"
        )
    if len(rig.arms) > 1:
        return slice(0, 2)
    moving = [k for k in range(2) if np.any(by_arm[:, :, k])]
    if len(moving) > 1:
        raise DatasetError(f"{folder}: has two arms, and rig {rig.name!r} has one; give a --rig with two")
    first = moving[0] if moving else 0
    return slice(first, first + 1)
