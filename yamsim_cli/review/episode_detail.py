"""Film strips, pictures and time lines of one episode, for the review page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config.rig import RigConfig
from ..core.dataset.dataset_paths import image_path
from ..core.dataset.reader import RecordedEpisode, open_recorded_episode
from ..core.dataset.records import EpisodeRecord
from ..core.dataset.row_format import drive_names
from ..core.errors import DatasetError
from ..core.images.image import Image
from ..core.images.jpeg import decode_jpeg, encode_jpeg
from ..core.rendering.view_cameras import resize_area

STRIP_FRAMES = 4  # pictures in a film strip: the first, two between, and the last
_STRIP_HEIGHT = 72  # px
_STRIP_ASPECT = 4 / 3  # width of each picture by its height; other pictures are cut at their sides
_STRIP_QUALITY = 70  # JPEG quality of a strip: 8 kB at this size


def film_strip(directory: Path, root: Path) -> bytes:
    """Return a JPEG with pictures of an episode, evenly spread over its time, side by side.

    A fixed camera is preferred to one on a wrist. An unreadable picture is grey.

    Raises:
        DatasetError: the episode has no pictures, its record is damaged, or a file lies outside of `root`.
    """
    episode = open_recorded_episode(directory)
    if not episode.record.cameras:
        raise DatasetError(f"{directory} has no pictures")
    camera = min(episode.record.cameras, key=lambda name: ("wrist" in name, name))
    width = round(_STRIP_HEIGHT * _STRIP_ASPECT)
    chosen = np.linspace(0, episode.record.frames - 1, STRIP_FRAMES).round().astype(int)
    cells = []
    for frame in chosen:
        cell = np.full((_STRIP_HEIGHT, width, 3), 128, np.uint8)
        try:
            image = decode_jpeg(read_picture(episode, camera, int(frame), root))
        except DatasetError:
            image = None
        if image is not None:
            cell = _cropped(image, width)
        cells.append(cell)
    return encode_jpeg(np.concatenate(cells, axis=1), _STRIP_QUALITY)


def _cropped(image: Image, width: int) -> Image:
    scale = max(width / image.shape[1], _STRIP_HEIGHT / image.shape[0])
    size = (max(width, round(image.shape[1] * scale)), max(_STRIP_HEIGHT, round(image.shape[0] * scale)))
    resized = resize_area(image, *size)
    left, top = (size[0] - width) // 2, (size[1] - _STRIP_HEIGHT) // 2
    return resized[top : top + _STRIP_HEIGHT, left : left + width]


def read_picture(episode: RecordedEpisode, camera: str, frame: int, root: Path) -> bytes:
    """Return the JPEG of a frame. Raise DatasetError if it is missing, altered, or lies outside of `root`."""
    if camera not in episode.record.cameras or not 0 <= frame < episode.record.frames:
        raise DatasetError(f"{episode.directory.name} has no frame {frame} of {camera[:100]!r}")
    require_inside(episode.directory / image_path(camera, frame), root)
    return episode.image(camera, frame)


def require_inside(path: Path, root: Path) -> None:
    """Raise DatasetError if a path, without links, lies outside of `root`."""
    if not path.resolve().is_relative_to(root.resolve()):
        raise DatasetError(f"{path} is a link out of the dataset, and is not read")


def timeline(directory: Path, rig: RigConfig | None, root: Path) -> dict[str, Any]:
    """Return joints, commands, grippers, goal measures and events of an episode as JSON data.

    Joints are in rad, and finger openings in m. Recordings without commands have none.

    Args:
        rig: for the names of the drives; None if unknown.
        root: the dataset's directory.

    Raises:
        DatasetError: a file is missing, altered or damaged, or lies outside of `root`.
    """
    require_inside(directory / "lowdim", root)
    episode = open_recorded_episode(directory)
    record, frames = episode.record, episode.frames()
    joints = _rows(frames, "joints")
    names = list(drive_names(rig)) if rig else []
    count = len(joints[0]) if joints else 0
    if len(names) != count:
        names = [f"drive {k + 1}" for k in range(count)]
    return {
        "episode": record.episode,
        "frames": record.frames,
        "period_s": record.frame_period_s,
        "times": [round(float(frame["timestamp"]), 4) for frame in frames],
        "cameras": list(record.cameras),
        "sizes": {camera: list(size) for camera, size in record.cameras.items()},
        "prompt": str(frames[0].get("language_prompt", "")) if frames else "",
        "series": {"joints": joints, "commands": _rows(frames, "ctrl")},
        "names": names,
        "grippers": _gripper_columns(rig, count),
        "measures": _measures(record),
        "events": _events(record, frames),
    }


def _rows(frames: list[dict[str, Any]], key: str) -> list[list[float | None]]:
    if not frames or not all(key in frame for frame in frames):
        return []
    rows = [np.ravel(frame[key]).astype(float).round(5).tolist() for frame in frames]
    return [[value if math.isfinite(value) else None for value in row] for row in rows]


def _gripper_columns(rig: RigConfig | None, count: int) -> list[int]:
    if rig is None:
        return []
    columns: list[int] = []
    start = 0
    for k in rig.recording_order:
        robot = rig.arms[k].robot
        columns += range(start + robot.dof, start + len(robot.drive_names))
        start += len(robot.drive_names)
    return [column for column in columns if column < count]


def _measures(record: Any) -> list[dict[str, Any]]:
    if not isinstance(record, EpisodeRecord):
        return [{"what": problem, "margin": None, "unit": ""} for problem in record.problems]
    return [{"what": each.what, "margin": each.margin, "unit": each.unit} for each in record.outcome.measures]


def _events(record: Any, frames: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return events with their frame: skills that were tried again, and welds that took or released an object."""
    events = []
    if isinstance(record, EpisodeRecord):
        events += [
            {"frame": each.frame, "what": f"{each.skill} again: {each.detail}"} for each in record.outcome.recoveries
        ]
    held = [np.ravel(frame["magnet"]).any() for frame in frames if "magnet" in frame]
    for k in range(1, len(held)):
        if held[k] != held[k - 1]:
            events.append({"frame": k, "what": "weld on" if held[k] else "weld off"})
    return sorted(events, key=lambda event: event["frame"])
