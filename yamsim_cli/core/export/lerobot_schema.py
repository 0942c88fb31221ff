"""LeRobotDataset v3.0 as data: the places of its files, its features, and the content of `meta/info.json`.

Source: lerobot 0.4.4 and 0.6.1, `lerobot.datasets`; the format's version is `CODEBASE_VERSION` there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..images.video import ENCODER

VERSION = "v3.0"
CHUNK_FILES = 1000
DATA_FILE_MB = 100
# Size up to which lerobot's tools join videos when they merge datasets. This export writes one for each episode.
VIDEO_FILE_MB = 200
# Every second frame is a key frame, since training reads single frames at random. Source: lerobot's own encoding.
KEY_FRAME_INTERVAL = 2

INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
# A file beside the format: the recorded episode of each exported one, and its seed, so that it can be made again.
PROVENANCE = "meta/yamsim.json"

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA = f"data/{_FILE}.parquet"
EPISODES = f"meta/episodes/{_FILE}.parquet"
VIDEO = "videos/{video_key}/" + _FILE + ".mp4"

STATE = "observation.state"
# lerobot gives this key to policies as a kind of its own, which stands in for pictures.
ENVIRONMENT_STATE = "observation.environment_state"
ACTION = "action"
# Of real recordings: the joints' velocities as measured, rad/s, and the frames' own times, s. Programs of the format
# leave both alone: their names begin neither with `observation` nor with `action`.
VELOCITIES = "joint_velocities"
RECORDED_TIME = "recorded_time"

# Prefix of a robot's type for two arms, as in lerobot's own names.
_TWO = "bi_"


@dataclass(frozen=True)
class Place:
    """One file of a series, with its number, its chunk, and its place in the chunk."""

    number: int

    @property
    def chunk(self) -> int:
        """Number of its chunk; a chunk has CHUNK_FILES files."""
        return self.number // CHUNK_FILES

    @property
    def file(self) -> int:
        """Its place within the chunk."""
        return self.number % CHUNK_FILES

    def path(self, pattern: str, **keys: str) -> str:
        """Its relative path by one of the patterns above."""
        return pattern.format(chunk_index=self.chunk, file_index=self.file, **keys)


@dataclass(frozen=True)
class Feature:
    """A column: dtype and shape of a frame's value, which is one number or a row of them, and the parts' names."""

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None

    def plain(self) -> dict[str, Any]:
        """The feature's entry in `info.json`."""
        return {"dtype": self.dtype, "shape": list(self.shape), "names": list(self.names) if self.names else None}


# Features that every dataset of the format has.
INDEX_FEATURES: Mapping[str, Feature] = {
    "timestamp": Feature("float32", (1,)),
    "frame_index": Feature("int64", (1,)),
    "episode_index": Feature("int64", (1,)),
    "index": Feature("int64", (1,)),
    "task_index": Feature("int64", (1,)),
}


def _matrix(letter: str, size: int) -> Feature:
    """The feature of a square matrix, row by row. Its elements are named by row and column from 0, such as `K02`.

    It is flat, since lerobot's own tools for editing datasets cannot write arrays of two dimensions.
    """
    names = tuple(f"{letter}{row}{column}" for row in range(size) for column in range(size))
    return Feature("float32", (len(names),), names)


def image_key(camera: str) -> str:
    """Key of a camera's images."""
    return f"observation.images.{camera}"


def intrinsics_key(camera: str) -> str:
    """Key of a camera's matrix K."""
    return f"camera.intrinsics.{camera}"


def extrinsics_key(camera: str) -> str:
    """Key of a camera's pose in the robot's base; with two arms, in the left one's."""
    return f"camera.extrinsics.{camera}"


def rows(names: Sequence[str]) -> Feature:
    """The feature of a row of numbers with names."""
    return Feature("float32", (len(names),), tuple(names))


def matrices(lenses: Collection[str], places: Collection[str]) -> dict[str, Feature]:
    """The features of what is known of cameras: of some their K, of some their pose."""
    features = {}
    for camera in dict.fromkeys((*lenses, *places)):
        if camera in lenses:
            features[intrinsics_key(camera)] = _matrix("K", 3)
        if camera in places:
            features[extrinsics_key(camera)] = _matrix("T", 4)
    return features


def info(
    cameras: Mapping[str, tuple[int, int]],
    fps: float,
    robots: Sequence[str],
    features: Mapping[str, Feature],
    *,
    episodes: int,
    frames: int,
    tasks: int,
) -> dict[str, Any]:
    """The content of `meta/info.json`.

    Args:
        cameras: camera -> width and height (px) of its images in the videos.
        robots: the model of each arm.
        features: those of the Parquet files.
    """
    images = {image_key(camera): _video(size, fps) for camera, size in cameras.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": robots[0] if len(robots) == 1 else _TWO + "_".join(dict.fromkeys(robots)),
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": DATA_FILE_MB,
        "video_files_size_in_mb": VIDEO_FILE_MB,
        "fps": int(fps) if fps == int(fps) else fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA,
        "video_path": VIDEO if cameras else None,
        "features": images | {key: feature.plain() for key, feature in features.items()},
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
        # lerobot uses these when it has to encode a video again.
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
