"""LeRobotDataset v3.0 as data: where its files lie, its features, and what `meta/info.json` says.

Source: lerobot 0.4.4 and 0.6.1, `lerobot.datasets`; the format's version is `CODEBASE_VERSION` there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..images.video import ENCODER
from ..scene.robot import ACTUATORS

VERSION = "v3.0"
CHUNK_FILES = 1000
DATA_FILE_MB = 100
# To this size lerobot's merging joins videos. They are written one for an episode, see `lerobot`.
VIDEO_FILE_MB = 200
# Training asks for single frames at random. Source: lerobot encodes so.
KEY_FRAME_INTERVAL = 2

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

# Before a robot's type where there are two of it, as in lerobot's own names.
_TWO = "bi_"


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
    """A column: dtype and shape of one frame's value, a number or a row of them, and its parts' names."""

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


def _matrix(letter: str, size: int) -> Feature:
    """A square matrix row by row, its elements named by row and column from 0: `K02` is the third of the first row.

    Flat, since lerobot's own tools for editing datasets do not write arrays of two dimensions.
    """
    names = tuple(f"{letter}{row}{column}" for row in range(size) for column in range(size))
    return Feature("float32", (len(names),), names)


def image_key(camera: str) -> str:
    """Feature of a camera's images."""
    return f"observation.images.{camera}"


def intrinsics_key(camera: str) -> str:
    """Feature of a camera's matrix K."""
    return f"camera.intrinsics.{camera}"


def extrinsics_key(camera: str) -> str:
    """Feature of a camera's pose in the robot's base; of two arms, in the left one's."""
    return f"camera.extrinsics.{camera}"


def columns(cameras: Mapping[str, tuple[int, int]], prefixes: Sequence[str]) -> dict[str, Feature]:
    """The features that the Parquet files hold: all but the images.

    Args:
        prefixes: what the names of each arm's parts begin with, in order. An action has all drives, then all welds.
    """
    drives = tuple(prefix + name for prefix in prefixes for name in ACTUATORS)
    commands = (*drives, *(f"{prefix}magnet" for prefix in prefixes))
    features = {
        STATE: Feature("float32", (len(drives),), drives),
        ACTION: Feature("float32", (len(commands),), commands),
    }
    for camera in cameras:
        features[intrinsics_key(camera)] = _matrix("K", 3)
        features[extrinsics_key(camera)] = _matrix("T", 4)
    return features | dict(INDEX_FEATURES)


def info(
    cameras: Mapping[str, tuple[int, int]],
    fps: float,
    robot: str,
    prefixes: Sequence[str],
    *,
    episodes: int,
    frames: int,
    tasks: int,
) -> dict[str, Any]:
    """What `meta/info.json` says.

    Args:
        cameras: camera -> width and height (px) of its images in the videos.
        robot: the model of each arm.
        prefixes: see `columns`.
    """
    images = {image_key(camera): _video(size, fps) for camera, size in cameras.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": robot if len(prefixes) == 1 else _TWO + robot,
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
        "features": images | {key: feature.plain() for key, feature in columns(cameras, prefixes).items()},
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
        # With these lerobot encodes what it has to encode again.
        "video.g": KEY_FRAME_INTERVAL,
        "video.crf": int(ENCODER["crf"]),
        "video.preset": ENCODER["preset"],
        "video.fast_decode": 0,
        "video.extra_options": {key: ENCODER[key] for key in ("bf", "mbtree")},
    }
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": details,
    }
