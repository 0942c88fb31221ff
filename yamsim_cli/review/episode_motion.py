"""Figures of each episode's motion, such as its jerk. They need all frames, so a cache keeps them by content hash."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..core.config.rig import RigConfig
from ..core.dataset.reader import RecordedEpisode, open_recorded_episode
from ..core.errors import DatasetError
from ..core.files.writing import write_file
from ..core.geometry.se3 import Array
from ..core.progress import Progress
from ..selection import episode_hash
from .episode_detail import gripper_columns, require_inside

MOTION_CACHE = "motion.json"  # name of the cache file
_CACHE_VERSION = 1  # value of `version`; other files are ignored

Figures = dict[str, float]


def measure_motion(episode: RecordedEpisode, grippers: Sequence[int]) -> Figures:
    """Return figures of an episode's measured joints; those that its frames do not allow are missing.

    `duration_s` is the time from the first to the last frame. `jerk` is the root mean square, over frames and joints,
    of the third difference of the joints, rad/s^3. `path_rad` is the sum of all joints' motions, rad. `joint<k>_min`
    and `joint<k>_max` are the range of joint k, from 1, rad.

    Args:
        grippers: columns of `joints` that are no joints.

    Raises:
        DatasetError: a file is missing, altered or damaged.
    """
    frames = episode.frames()
    times = np.array([float(frame["timestamp"]) for frame in frames])
    figures = {"duration_s": round(float(times[-1] - times[0]), 4)} if len(times) else {}
    if not frames or not all("joints" in frame for frame in frames):
        return figures
    joints = np.array([np.ravel(frame["joints"]) for frame in frames], float)
    arms = np.delete(joints, [column for column in grippers if column < joints.shape[1]], axis=1)
    known = arms[np.isfinite(arms).all(axis=1)]
    if not len(known):
        return figures
    figures["path_rad"] = round(float(np.abs(np.diff(known, axis=0)).sum()), 4)
    if (jerk := _rms_jerk(arms, times)) is not None:
        figures["jerk"] = round(jerk, 3)
    for k, (low, high) in enumerate(zip(known.min(axis=0), known.max(axis=0), strict=True), start=1):
        figures |= {f"joint{k}_min": round(float(low), 4), f"joint{k}_max": round(float(high), 4)}
    return figures


def _rms_jerk(joints: Array, times: Array) -> float | None:
    """Return the RMS of the third difference at the median period; None without four measured frames in a row."""
    if len(times) < 4 or (period := float(np.median(np.diff(times)))) <= 0:
        return None
    thirds = np.diff(joints, 3, axis=0) / period**3
    thirds = thirds[np.isfinite(thirds).all(axis=1)]
    return float(np.sqrt(np.mean(thirds**2))) if len(thirds) else None


def read_motion(
    directories: Mapping[int, Path], rig: RigConfig | None, cache: Path, root: Path, progress: Progress
) -> dict[int, Figures]:
    """Return episode number -> figures of its motion. Episodes that cannot be read have none.

    Args:
        rig: for the columns of the grippers; None if unknown, then all columns count.
        cache: file of known figures, which is extended, also when the reading is interrupted.
        root: the dataset's directory; files outside of it are not read.
    """
    known = _read_cache(cache)
    before = len(known)
    found: dict[int, Figures] = {}
    try:
        for done, (number, directory) in enumerate(directories.items()):
            progress(done, len(directories))
            try:
                figures = _known_figures(directory, rig, known, root)
            except DatasetError:
                continue
            found[number] = figures
        progress(len(directories), len(directories))
    finally:
        if len(known) > before:
            _write_cache(cache, known)
    return found


def _known_figures(directory: Path, rig: RigConfig | None, known: dict[str, Figures], root: Path) -> Figures:
    key = episode_hash(directory)
    if rig is None:
        key += " all columns"
    if key not in known:
        require_inside(directory / "lowdim", root)
        episode = open_recorded_episode(directory)
        width = episode.record.arms * episode.record.drives
        known[key] = measure_motion(episode, gripper_columns(rig, width))
    return known[key]


def _read_cache(file: Path) -> dict[str, Figures]:
    try:
        data = json.loads(file.read_bytes())
        if data["version"] != _CACHE_VERSION:
            return {}
        return {
            str(key): {str(name): float(value) for name, value in figures.items()}
            for key, figures in data["episodes"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}  # the frames are read instead


def _write_cache(file: Path, known: Mapping[str, Figures]) -> None:
    data = json.dumps({"version": _CACHE_VERSION, "episodes": known}, separators=(",", ":"))
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, data.encode())
    except OSError:
        pass  # the next review reads the frames again
