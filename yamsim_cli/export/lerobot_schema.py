"""Files of LeRobotDataset v3.0: paths, features, `meta/info.json`, and Parquet tables.

Source: lerobot 0.4.4 and 0.6.1, `lerobot.datasets`, where `CODEBASE_VERSION` is the format version.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.closable import Closable
from ..core.images.video import H264_OPTIONS

VERSION = "v3.0"  # format version in `meta/info.json`
CHUNK_FILES = 1000  # files per `chunk-NNN` folder
DATA_FILE_MB = 100  # MB, at which a new Parquet file begins
VIDEO_FILE_MB = 200  # MB, up to which lerobot's tools join videos; this export writes one file per episode
KEY_FRAME_INTERVAL = 2  # frames, as lerobot encodes: training reads single frames at random

INFO_FILE = "meta/info.json"
STATS_FILE = "meta/stats.json"
TASKS_FILE = "meta/tasks.parquet"
# Extra file outside the format: source episode and seed of each exported episode.
PROVENANCE_FILE = "meta/yamsim.json"

_SERIES_FILE_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_FILE_PATTERN = f"data/{_SERIES_FILE_PATTERN}.parquet"
EPISODES_FILE_PATTERN = f"meta/episodes/{_SERIES_FILE_PATTERN}.parquet"
VIDEO_FILE_PATTERN = "videos/{video_key}/" + _SERIES_FILE_PATTERN + ".mp4"

STATE_KEY = "observation.state"
# Object poses; lerobot gives this key to policies that use no images.
ENVIRONMENT_STATE_KEY = "observation.environment_state"
ACTION_KEY = "action"
# Keys of real recordings: measured joint velocities, rad/s, and recorded frame times, s. Other programs ignore both,
# because the names begin neither with `observation` nor with `action`.
VELOCITIES_KEY = "joint_velocities"
RECORDED_TIME_KEY = "recorded_time"

_BIMANUAL_ROBOT_PREFIX = "bi_"  # as in lerobot's own robot types


@dataclass(frozen=True)
class SeriesFile:
    """Number of a file in a series, which determines its chunk folder and its path."""

    number: int

    @property
    def chunk_number(self) -> int:
        """Number of the chunk that contains the file."""
        return self.number // CHUNK_FILES

    @property
    def number_in_chunk(self) -> int:
        """Number of the file within its chunk."""
        return self.number % CHUNK_FILES

    def path(self, pattern: str, **keys: str) -> str:
        """Return the path in the dataset, from a pattern such as `DATA_FILE_PATTERN`."""
        return pattern.format(chunk_index=self.chunk_number, file_index=self.number_in_chunk, **keys)


@dataclass(frozen=True)
class LeRobotFeature:
    """A column of the dataset: dtype, shape and element names of one frame's value."""

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None

    def to_json_data(self) -> dict[str, Any]:
        """Return the entry of the feature in `info.json`."""
        return {"dtype": self.dtype, "shape": list(self.shape), "names": list(self.names) if self.names else None}


# Features that every dataset of the format has.
INDEX_FEATURES: Mapping[str, LeRobotFeature] = {
    "timestamp": LeRobotFeature("float32", (1,)),
    "frame_index": LeRobotFeature("int64", (1,)),
    "episode_index": LeRobotFeature("int64", (1,)),
    "index": LeRobotFeature("int64", (1,)),
    "task_index": LeRobotFeature("int64", (1,)),
}


def _matrix_feature(letter: str, size: int) -> LeRobotFeature:
    """Return the feature of a square matrix in row-major order, with element names such as `K02` (row 0, column 2).

    Flat, because lerobot's tools for editing datasets cannot write two-dimensional arrays.
    """
    names = tuple(f"{letter}{row}{column}" for row in range(size) for column in range(size))
    return LeRobotFeature("float32", (len(names),), names)


def image_key(camera: str) -> str:
    """Return the key of a camera's images."""
    return f"observation.images.{camera}"


def intrinsics_key(camera: str) -> str:
    """Return the key of a camera's matrix K."""
    return f"camera.intrinsics.{camera}"


def extrinsics_key(camera: str) -> str:
    """Return the key of a camera's pose in the base of the only or left arm."""
    return f"camera.extrinsics.{camera}"


def row_feature(names: Sequence[str]) -> LeRobotFeature:
    """Return a float32 feature with one element per name."""
    return LeRobotFeature("float32", (len(names),), tuple(names))


def matrix_features(intrinsics: Collection[str], extrinsics: Collection[str]) -> dict[str, LeRobotFeature]:
    """Return the features of cameras with a known K, and of cameras with a known pose."""
    features = {}
    for camera in dict.fromkeys((*intrinsics, *extrinsics)):
        if camera in intrinsics:
            features[intrinsics_key(camera)] = _matrix_feature("K", 3)
        if camera in extrinsics:
            features[extrinsics_key(camera)] = _matrix_feature("T", 4)
    return features


def info_json(
    cameras: Mapping[str, tuple[int, int]],
    fps: float,
    robots: Sequence[str],
    features: Mapping[str, LeRobotFeature],
    *,
    episodes: int,
    frames: int,
    tasks: int,
) -> dict[str, Any]:
    """Return the content of `meta/info.json`. `cameras` is camera -> (width, height) of its video, px."""
    images = {image_key(camera): _video_feature(size, fps) for camera, size in cameras.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": robots[0] if len(robots) == 1 else _BIMANUAL_ROBOT_PREFIX + "_".join(dict.fromkeys(robots)),
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": DATA_FILE_MB,
        "video_files_size_in_mb": VIDEO_FILE_MB,
        "fps": int(fps) if fps == int(fps) else fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA_FILE_PATTERN,
        "video_path": VIDEO_FILE_PATTERN if cameras else None,
        "features": images | {key: feature.to_json_data() for key, feature in features.items()},
    }


def _video_feature(size: tuple[int, int], fps: float) -> dict[str, Any]:
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
        # lerobot uses these entries to encode a video again.
        "video.g": KEY_FRAME_INTERVAL,
        "video.crf": int(H264_OPTIONS["crf"]),
        "video.preset": H264_OPTIONS["preset"],
        "video.fast_decode": 0,
        "video.extra_options": {key: H264_OPTIONS[key] for key in ("bf", "mbtree")},
    }
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": details,
    }


class TableSeries(Closable):
    """Writes tables with the same columns to a series of Parquet files of up to `limit_mb`, MB. Closing completes the
    last.

    `pattern` of the paths below `root`: such as `DATA_FILE_PATTERN`.
    """

    def __init__(self, root: Path, pattern: str, limit_mb: float) -> None:
        self._root, self._pattern, self._limit = root, pattern, limit_mb * 1e6
        self._writer: Any = None
        self._place = SeriesFile(0)
        self._path = root

    def file_for_next_table(self) -> SeriesFile:
        """Return the file for the next table."""
        if self._writer is not None and self._path.stat().st_size >= self._limit:
            self.close()
            self._place = SeriesFile(self._place.number + 1)
        return self._place

    def write(self, table: Any) -> None:
        """Append a table."""
        import pyarrow.parquet

        place = self.file_for_next_table()
        if self._writer is None:
            self._path = self._root / place.path(self._pattern)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pyarrow.parquet.ParquetWriter(self._path, table.schema, compression="snappy")
        self._writer.write_table(table)

    def close(self) -> None:
        """Write the footer of the last file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def frames_table(columns: Mapping[str, LeRobotFeature], values: Mapping[str, NDArray[Any]]) -> Any:
    """Return an episode's table, from values (frames, ...) by feature."""
    import pyarrow

    def feature_column(key: str, feature: LeRobotFeature) -> Any:
        flat = pyarrow.array(np.asarray(values[key], feature.dtype).ravel())
        (width,) = feature.shape
        return flat if width == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, width)

    return pyarrow.table([feature_column(key, feature) for key, feature in columns.items()], names=list(columns))


def episode_table(row: Mapping[str, Any]) -> Any:
    """Return one row of `meta/episodes`, with arrays converted to lists."""
    import pyarrow

    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in row.items()}
    return pyarrow.table({key: pyarrow.array([value]) for key, value in plain.items()})


def write_tasks(root: Path, tasks: Sequence[str]) -> None:
    """Write `meta/tasks.parquet`: the task numbers, with the task texts as pandas index."""
    import pyarrow
    import pyarrow.parquet

    def column_metadata(name: str, kind: str, numpy_type: str) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_type, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column_metadata("task_index", "int64", "int64"), column_metadata("task", "unicode", "object")],
        "pandas_version": "2.0.0",
    }
    table = pyarrow.table({"task_index": pyarrow.array(range(len(tasks)), pyarrow.int64()), "task": list(tasks)})
    table = table.replace_schema_metadata({"pandas": json.dumps(pandas)})
    (root / TASKS_FILE).parent.mkdir(parents=True, exist_ok=True)
    pyarrow.parquet.write_table(table, root / TASKS_FILE)
