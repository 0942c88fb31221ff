"""Read motions from yamsim's episodes and datasets, and from recordings in all known formats."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.dataset_paths import EPISODE_FILE
from yamsim_cli.core.dataset.imported_records import is_yamsim_data
from yamsim_cli.core.dataset.reader import RecordedEpisode, open_all_episodes, open_recorded_episode
from yamsim_cli.core.errors import DatasetError, UsageError, suggest_similar
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import RecordedMotion

from .abc_training_files import abc_training_folders, read_abc_training
from .csv_file import read_csv
from .lerobot_files import INFO_FILE, read_lerobot
from .maker_files import maker_folders, read_maker
from .mcap_file import mcap_files, read_mcap
from .raiden_files import ROBOT_DATA, read_lowdim, read_raiden_raw
from .recording import Recording, split_arms

# Arguments: path, rig, naming of columns (None to find one), locations.
Reader = Callable[[Path, RigConfig, str | None, Locations], list[Recording]]

_READERS: Mapping[str, Reader] = {
    "csv": lambda path, rig, mapping, where: [Recording(read_csv(path, rig), "metres")],
    "raiden_raw": lambda path, rig, mapping, where: read_raiden_raw(path, rig),
    "lowdim": lambda path, rig, mapping, where: read_lowdim(path, rig),
    "lerobot": read_lerobot,
    "mcap": read_mcap,
    "maker": lambda path, rig, mapping, where: read_maker(path, rig),
    "abc_training": lambda path, rig, mapping, where: read_abc_training(path, rig),
}
_FORMAT_OF_SUFFIX = {".csv": "csv", ".mcap": "mcap", ".npz": "raiden_raw"}


def detect_format(path: Path) -> str:
    """Return a file's or folder's format.

    Raises:
        DatasetError: the path does not exist, its format is unknown, or it is a dataset of yamsim's.
    """
    if not path.exists():
        raise DatasetError(f"{path} does not exist")
    if path.is_file():
        if path.suffix.lower() in _FORMAT_OF_SUFFIX:
            return _FORMAT_OF_SUFFIX[path.suffix.lower()]
    elif (path / ROBOT_DATA).is_file():
        return "raiden_raw"
    elif (path / INFO_FILE).is_file():
        return "lerobot"
    elif is_yamsim_data(path):
        raise DatasetError(f"{path}: is already an episode or a dataset of yamsim, and needs no import")
    elif (path / "lowdim").is_dir() or any(path.glob("*/lowdim")):
        return "lowdim"
    elif maker_folders(path):
        return "maker"
    elif abc_training_folders(path):
        return "abc_training"
    elif mcap_files(path):
        return "mcap"
    raise DatasetError(
        f"{path}: is not a known kind of recording; valid: a .csv or .mcap, a robot_data.npz or its folder, a folder "
        "with rgb/ and lowdim/ or of such folders, a LeRobot dataset, episodes of the maker's or of ABC's"
    )


def format_reader(name: str) -> Reader:
    """Return the reader of a format, such as `csv`. Raises `UsageError` if no format has that name."""
    if name not in _READERS:
        raise UsageError(f"--format {name!r} is not valid; {suggest_similar(name, _READERS)}")
    return _READERS[name]


def read_motions(
    recordings: Sequence[Path], rig: RigConfig, locations: Locations, mapping: str | None = None
) -> list[RecordedMotion]:
    """Return recordings' motions in order, one per episode; `mapping` is a config or YAML file of columns.

    Raises:
        DatasetError: a recording is missing, unreadable or damaged, or does not fit the rig.
        UsageError: no recording has a motion.
    """
    motions: list[RecordedMotion] = []
    for path in recordings:
        if is_yamsim_data(path):
            stored = [open_recorded_episode(path)] if (path / EPISODE_FILE).exists() else open_all_episodes(path)
            motions += [read_episode(episode, rig) for episode in stored]
        else:
            read = format_reader(detect_format(path))
            motions += [recording.motion_in_metres(rig) for recording in read(path, rig, mapping, locations)]
    if not motions:
        raise UsageError("no recording contains a motion; give a .csv, or the directory of an episode or of a dataset")
    return motions


def read_episode(episode: RecordedEpisode, rig: RigConfig) -> RecordedMotion:
    """Return an episode's motion.

    A simulated one has a sample per control tick, joints being NaN between frames; an imported one a sample per frame.

    Raises:
        DatasetError: the episode is damaged or does not fit the rig.
    """
    record, name = episode.record, str(episode.directory)
    drives = record.drives
    if record.arms != len(rig.arms) or drives not in (rig.drive_count, min(arm.robot.dof for arm in rig.arms)):
        raise DatasetError(
            f"{name}: has {record.arms} arms of {drives} drives, and rig {rig.name!r} has {len(rig.arms)} of "
            f"{rig.drive_count}; give --rig {record.rig}"
        )
    frames = episode.frames()
    if len(frames) < 2:
        raise DatasetError(f"{name}: has {len(frames)} frames; a motion needs at least two")
    times = np.array([frame["timestamp"] for frame in frames], dtype=np.float64)
    if np.any(np.diff(times) <= 0):
        raise DatasetError(f"{name}: timestamps do not increase; check it with yamsim summarize --strict")

    def drive_rows(key: str) -> Array:
        values = [np.asarray(frame[key], dtype=np.float64).ravel() for frame in frames]
        return np.array(values).reshape(len(frames), record.arms, drives)

    joints, commands = drive_rows("joints"), drive_rows("ctrl") if "ctrl" in frames[0] else None
    times -= times[0]
    if "sim_ctrl" in frames[0]:
        times, joints, commands = _per_tick_samples(times, joints, frames, rig)
    return RecordedMotion(name, times, split_arms(joints, commands, rig))


def _per_tick_samples(
    times: Array, joints: Array, frames: list[dict[str, Any]], rig: RigConfig
) -> tuple[Array, Array, Array]:
    order = np.concatenate([np.arange(rig.drive_count) + arm * rig.drive_count for arm in rig.recording_order])
    starts, commands, measured = [], [], []
    for k, frame in enumerate(frames):
        ticks = np.asarray(frame["sim_ctrl"], dtype=np.float64)
        # The last frame may have fewer ticks, of the same length.
        if k + 1 < len(times):
            tick = (times[k + 1] - times[k]) / len(ticks)
        starts += list(times[k] + tick * np.arange(len(ticks)))
        commands += list(ticks[:, order].reshape(len(ticks), len(rig.arms), rig.drive_count))
        measured += [joints[k], *np.full((len(ticks) - 1, *joints[k].shape), np.nan)]
    return np.array(starts), np.array(measured), np.array(commands)
