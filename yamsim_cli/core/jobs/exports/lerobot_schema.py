"""LeRobotDataset v3.0 as data: where its files lie, its features, and what `meta/info.json` says.

Source: lerobot 0.4.4, `lerobot.datasets`; the format's version is `CODEBASE_VERSION` there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...scene.robot import JOINTS

VERSION = "v3.0"
CHUNK_FILES = 1000
DATA_FILE_MB = 100
VIDEO_FILE_MB = 200

INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
# Not of the format: which episode of the dataset each one is, and its seed, so that it can be made again.
PROVENANCE = "meta/yamsim.json"

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA = f"data/{_FILE}.parquet"
EPISODES = f"meta/episodes/{_FILE}.parquet"
VIDEO = "videos/{video_key}/" + _FILE + ".mp4"

STATE = "observation.state"
ACTION = "action"

_COMMANDS = (*JOINTS, "gripper")


@dataclass(frozen=True)
class Place:
    """One of a series of files: by its number, its chunk and its place in it."""

    number: int

    @property
    def chunk(self) -> int:
        """Of CHUNK_FILES files each."""
        return self.number // CHUNK_FILES

    @property
    def file(self) -> int:
        """Within its chunk."""
        return self.number % CHUNK_FILES

    def path(self, pattern: str, **keys: str) -> str:
        """Relative path by one of the patterns above."""
        return pattern.format(chunk_index=self.chunk, file_index=self.file, **keys)


@dataclass(frozen=True)
class Feature:
    """A column: dtype and shape of one frame's value, and its parts' names."""

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None

    def plain(self) -> dict[str, Any]:
        """As `info.json` has it."""
        return {"dtype": self.dtype, "shape": list(self.shape), "names": list(self.names) if self.names else None}


# What every dataset of the format has.
INDEX_FEATURES: Mapping[str, Feature] = {
    "timestamp": Feature("float32", (1,)),
    "frame_index": Feature("int64", (1,)),
    "episode_index": Feature("int64", (1,)),
    "index": Feature("int64", (1,)),
    "task_index": Feature("int64", (1,)),
}


def image_key(camera: str) -> str:
    """Feature of a camera's images."""
    return f"observation.images.{camera}"


def intrinsics_key(camera: str) -> str:
    """Feature of a camera's matrix K."""
    return f"observation.intrinsics.{camera}"


def extrinsics_key(camera: str) -> str:
    """Feature of a camera's pose in the robot's base."""
    return f"observation.extrinsics.{camera}"


def columns(cameras: Mapping[str, tuple[int, int]]) -> dict[str, Feature]:
    """The features that the Parquet files hold: all but the images."""
    features = {
        STATE: Feature("float32", (7,), _COMMANDS),
        ACTION: Feature("float32", (8,), (*_COMMANDS, "magnet")),
    }
    for camera in cameras:
        features[intrinsics_key(camera)] = Feature("float32", (3, 3))
        features[extrinsics_key(camera)] = Feature("float32", (4, 4))
    return features | dict(INDEX_FEATURES)


def info(
    cameras: Mapping[str, tuple[int, int]],
    fps: float,
    robot: str,
    *,
    episodes: int,
    frames: int,
    tasks: int,
) -> dict[str, Any]:
    """What `meta/info.json` says.

    Args:
        cameras: camera -> width and height (px) of its images in the videos.
    """
    images = {image_key(camera): _video(size, fps) for camera, size in cameras.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": DATA_FILE_MB,
        "video_files_size_in_mb": VIDEO_FILE_MB,
        "fps": int(fps) if fps == int(fps) else fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA,
        "video_path": VIDEO,
        "features": images | {key: feature.plain() for key, feature in columns(cameras).items()},
    }


def _video(size: tuple[int, int], fps: float) -> dict[str, Any]:
    width, height = size
    details = {
        "video.height": height,
        "video.width": width,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": int(fps) if fps == int(fps) else fps,
        "video.channels": 3,
        "has_audio": False,
    }
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": details,
    }
