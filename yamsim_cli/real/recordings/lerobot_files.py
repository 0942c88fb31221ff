"""Read LeRobot datasets of YAM arms, versions 2.0 to 3.0: Parquet rows, images in MP4 or in the rows.

Source: lerobot 0.4.4 and 0.6.1. `meta/info.json` has `codebase_version`, `video_path` and `features`. Version 2 has a
Parquet file and an MP4 per episode; version 3 several episodes per file, listed in `meta/episodes/`.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
import string
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard, get_args

import numpy as np

from yamsim_cli.core.config.real_recordings import GripperUnit
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.extras import require_library
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image_files import decode_image
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.images.video import read_video_frames
from yamsim_cli.core.recorded_motion import RecordedMotion

from .column_names import arm_columns, arm_motions_from_columns, find_naming
from .recording import JPEG_QUALITY, CameraImages, Recording, times_from_seconds

INFO_FILE = "meta/info.json"
_STATE, _ACTION, _PICTURE = "observation.state", "action", "observation.images."
# Added by yamsim's export of real recordings: recorded times, and the grippers' unit.
_OWN_TIME, _OWN_FILE, _OWN_UNIT = "recorded_time", "meta/yamsim.json", "gripper"
_JPEG_START = b"\xff\xd8"
_MAX_JSONL_BYTES = 1 << 26

# Fields of `video_path` in lerobot 0.4.4 and 0.6.1: the first three in version 2, the first and last two in 3.
_PATTERN_FIELDS = ("video_key", "episode_chunk", "episode_index", "chunk_index", "file_index")
_FORMAT_SPEC = re.compile(r"(0?[1-9]?d)?")  # padded to at most 9 digits; wider padding could fill the memory
_MAX_PATTERN_LENGTH = 1000  # characters of `video_path`; file paths have at most 4096 bytes
_MAX_FPS = 10_000.0  # far above any camera's rate
_MAX_NUMBER = 1_000_000_000  # largest number in a path, and of episodes in a chunk
_CHUNK_SIZE = 1000  # episodes, if a version 2 dataset states no `chunks_size`. Source: lerobot 0.4.4


@dataclass(frozen=True)
class VideoPaths:
    """Finds a dataset's videos by the pattern in its unchecked `meta/info.json`."""

    path: Path
    info: Mapping[str, Any]

    @property
    def fps(self) -> float:
        """Frames per second. Raises `DatasetError` if `fps` is missing or not positive."""
        fps = self.info.get("fps")
        if not _is_number(fps) or not 0 < fps <= _MAX_FPS:
            raise self._invalid_value_error("fps", f"a number above 0, at most {_MAX_FPS:g} frames per second")
        return float(fps)

    def check_metadata(self) -> None:
        """Check frame rate, path pattern and chunk size. Raises `DatasetError` if a value is missing or invalid."""
        _ = self.fps, self._path_pattern, self._chunk_size

    def locate_video(self, key: str, number: int, row: Mapping[str, Any] | None) -> tuple[Path, float]:
        """Return the file with a camera's video, and the time at which the episode begins in it, s.

        Args:
            key: such as `observation.images.wrist`.
            number: of the episode.
            row: of version 3's `meta/episodes/`.

        Raises:
            DatasetError: `info.json` or the row is invalid, or the file lies outside the dataset.
        """
        pattern = self._path_pattern
        numbers = {"episode_chunk": number // self._chunk_size, "episode_index": number}
        begin = 0.0
        if row is not None:
            places = {name: f"videos/{key}/{name}" for name in ("chunk_index", "file_index", "from_timestamp")}
            for name in places.values():
                value = row.get(name)
                whole = isinstance(value, int) and value <= _MAX_NUMBER
                valid = whole or name.endswith("timestamp")
                if not _is_number(value) or not valid or not 0 <= value < math.inf:
                    raise DatasetError(
                        f"{self.path}/meta/episodes: episode {number}: {name} is {_shortened_repr(value)}"
                    )
            begin = float(row[places.pop("from_timestamp")])
            numbers = {name: row[place] for name, place in places.items()}
        fields = [field for _, field, _, _ in string.Formatter().parse(pattern) if field is not None]
        if unknown := [field for field in fields if field not in (*numbers, "video_key")]:
            raise self._invalid_value_error(
                "video_path", f"for this version only video_key, {', '.join(numbers)}", unknown
            )
        file = (self.path / pattern.format(video_key=key, **numbers)).resolve()
        if not file.is_relative_to(self.path.resolve()):
            raise DatasetError(f"{self.path / INFO_FILE}: video_path {pattern!r} leads out of the dataset")
        return file, begin

    @property
    def _path_pattern(self) -> str:
        pattern = self.info.get("video_path")
        valid = (
            f"a path with the fields {', '.join(_PATTERN_FIELDS)}, each plain or padded such as {{episode_index:06d}}"
        )
        if not isinstance(pattern, str) or not 0 < len(pattern) <= _MAX_PATTERN_LENGTH or "\0" in pattern:
            raise self._invalid_value_error("video_path", valid)
        try:
            parts = list(string.Formatter().parse(pattern))
        except ValueError as error:
            raise self._invalid_value_error("video_path", valid) from error
        for _, field, spec, conversion in parts:
            if field is None:
                continue
            padding = _FORMAT_SPEC.fullmatch(spec or "") and (field != "video_key" or not spec)
            if field not in _PATTERN_FIELDS or conversion is not None or not padding:
                raise self._invalid_value_error("video_path", valid)
        return pattern

    @property
    def _chunk_size(self) -> int:
        size = self.info.get("chunks_size", _CHUNK_SIZE)
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= _MAX_NUMBER:
            raise self._invalid_value_error("chunks_size", f"a whole number from 1 to {_MAX_NUMBER}")
        return size

    def _invalid_value_error(self, key: str, valid: str, found: object = None) -> DatasetError:
        value = found if found is not None else self.info.get(key)
        problem = f"is {_shortened_repr(value)}" if key in self.info else "is missing"
        return DatasetError(f"{self.path / INFO_FILE}: {key} {problem}; valid: {valid}")


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shortened_repr(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


@dataclass(frozen=True)
class _LerobotDataset:
    path: Path
    info: Mapping[str, Any]
    rig: RigConfig
    mapping: str | None
    locations: Locations

    @property
    def video_paths(self) -> VideoPaths:
        return VideoPaths(self.path, self.info)

    def feature_names(self, key: str, width: int) -> list[str]:
        """Return a feature's columns. Some programs nest the list in a list or a dictionary."""
        names = self.info["features"].get(key, {}).get("names")
        if isinstance(names, dict):
            names = next(iter(names.values()), None)
        if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
            names = names[0]
        if not isinstance(names, list) or len(names) != width or not all(isinstance(name, str) for name in names):
            raise DatasetError(f"{self.path / INFO_FILE}: {key}: names are {names!r}; valid: {width} names in a list")
        return names

    @property
    def gripper_unit(self) -> GripperUnit | None:
        try:
            content = json.loads((self.path / _OWN_FILE).read_bytes())
        except (OSError, ValueError):
            return None
        unit = content.get(_OWN_UNIT) if isinstance(content, dict) else None
        return unit if unit in get_args(GripperUnit) else None

    def camera_keys(self, kind: str) -> list[str]:
        """Return cameras of dtype `kind`: `video`, or `image` for an image per row."""
        return [
            key
            for key, feature in self.info["features"].items()
            if key.startswith(_PICTURE) and isinstance(feature, dict) and feature.get("dtype") == kind
        ]


def read_lerobot(path: Path, rig: RigConfig, mapping: str | None, locations: Locations) -> list[Recording]:
    """Return a LeRobot dataset's episodes; `mapping` is a config or YAML file of columns, None to find one.

    Raises:
        DatasetError: the dataset is damaged or has an unsupported version, or no naming fits.
        ResourceError: pyarrow is not installed.
    """
    require_library("a LeRobot dataset", "pyarrow", "lerobot")
    try:
        info = json.loads((path / INFO_FILE).read_bytes())
        version, features = str(info["codebase_version"]), info["features"]
    except OSError as error:
        raise DatasetError(f"{path / INFO_FILE} cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path / INFO_FILE}: is not of a LeRobot dataset: {error}") from error
    if not isinstance(features, dict) or version.split(".")[0] not in ("v2", "v3"):
        raise DatasetError(f"{path / INFO_FILE}: codebase_version is {version!r}; valid: v2.0, v2.1 and v3.0")
    dataset = _LerobotDataset(path, info, rig, mapping, locations)
    if dataset.camera_keys("video"):
        dataset.video_paths.check_metadata()
    tasks = _read_tasks(path)
    rows = _read_episode_rows(path, version)
    recordings = []
    for number, table in _read_episodes(path):
        row, count = rows.get(number, {}), len(table["episode_index"])
        if (stated := row.get("length")) is not None and stated != count:
            raise DatasetError(
                f"{path} episode {number}: has {count} rows, and meta/ says {stated}; it was probably cut off: copy "
                "it again, or leave it out"
            )
        recordings.append(_read_recording(dataset, number, table, tasks, row if version.startswith("v3") else None))
    if not recordings:
        raise DatasetError(f"{path}/data: contains no episode")
    return recordings


def _read_recording(
    dataset: _LerobotDataset,
    number: int,
    table: Mapping[str, Any],
    tasks: Mapping[int, str],
    row: Mapping[str, Any] | None,
) -> Recording:
    name = f"{dataset.path} episode {number}"
    if _STATE not in table:
        raise DatasetError(f"{name}: has no {_STATE}; its columns are {', '.join(table)}")
    measured = _number_rows(table, _STATE, name)
    columns = dataset.feature_names(_STATE, measured.shape[1])
    names = find_naming(columns, dataset.rig, dataset.mapping, name, dataset.locations)
    commanded = None
    if _ACTION in table:
        actions = _number_rows(table, _ACTION, name)
        by_name = dict(zip(dataset.feature_names(_ACTION, actions.shape[1]), actions.T, strict=True))
        # Actions with other columns, such as hand poses, are no drive commands.
        if all(column in by_name for arm in names.arms.values() for column in arm_columns(arm)):
            commanded = by_name
    times = times_from_seconds(np.ravel(np.asarray(table.get(_OWN_TIME, table["timestamp"]), dtype=np.float64)), name)
    arms = arm_motions_from_columns(names, dataset.rig, dict(zip(columns, measured.T, strict=True)), commanded)
    samples = np.arange(len(times), dtype=np.int64)
    readers: dict[str, Callable[[], Iterator[bytes]]] = {
        key: functools.partial(_video_jpegs, dataset.video_paths, key, number, row, len(times))
        for key in dataset.camera_keys("video")
    }
    readers |= {
        key: functools.partial(_row_jpegs, table[key], f"{name}: {key}")
        for key in dataset.camera_keys("image")
        if key in table
    }
    pictures = {
        key.removeprefix(_PICTURE).replace(".", "_"): CameraImages(samples, read) for key, read in readers.items()
    }
    task = int(np.asarray(table["task_index"]).ravel()[0]) if "task_index" in table else -1
    return Recording(
        RecordedMotion(name, times, arms), dataset.gripper_unit or names.gripper, pictures, tasks.get(task, "")
    )


def _number_rows(table: Mapping[str, Any], key: str, name: str) -> Array:
    try:
        rows = np.array([np.asarray(row, dtype=np.float64).ravel() for row in table[key]])
    except (ValueError, TypeError) as error:
        raise DatasetError(f"{name}: {key} holds no rows of numbers: {error}") from error
    if rows.ndim != 2 or not np.isfinite(rows).all():
        raise DatasetError(
            f"{name}: {key} has the shape {rows.shape}, and {np.count_nonzero(~np.isfinite(rows))} values are not "
            "finite"
        )
    return rows


def _read_episodes(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield episodes, which version 3 may continue in the next file."""
    unfinished: tuple[int, dict[str, list[Any]]] | None = None
    for file in sorted((path / "data").glob("chunk-*/*.parquet")):
        table = _read_parquet_table(file)
        numbers = np.asarray(table["episode_index"]).ravel()
        edges = np.flatnonzero(np.r_[True, np.diff(numbers) != 0, True])
        for first, end in itertools.pairwise(edges):
            number = int(numbers[first])
            rows = {key: list(values[first:end]) for key, values in table.items()}
            if unfinished and unfinished[0] == number:
                for key, values in rows.items():
                    unfinished[1][key] += values
                continue
            if unfinished:
                yield unfinished
            unfinished = (number, rows)
    if unfinished:
        yield unfinished


def _read_parquet_table(file: Path) -> dict[str, Any]:
    import pyarrow
    import pyarrow.parquet

    try:
        return {str(key): values for key, values in pyarrow.parquet.read_table(file).to_pydict().items()}
    except (OSError, pyarrow.ArrowException) as error:
        raise DatasetError(f"{file} cannot be read: {error}; copy it again") from error


def _read_tasks(path: Path) -> dict[int, str]:
    parquet = path / "meta/tasks.parquet"
    if parquet.is_file():
        table = _read_parquet_table(parquet)
        words: list[Any] = next((table[key] for key in ("task", "__index_level_0__") if key in table), [])
        return {int(number): str(word) for number, word in zip(table.get("task_index", []), words, strict=False)}
    rows = _json_lines(path / "meta/tasks.jsonl")
    return {row["task_index"]: str(row.get("task", "")) for row in rows if isinstance(row.get("task_index"), int)}


def _read_episode_rows(path: Path, version: str) -> dict[int, dict[str, Any]]:
    """Return episode -> its length and, in version 3, where its videos are."""
    if not version.startswith("v3"):
        rows = _json_lines(path / "meta/episodes.jsonl")
        return {row["episode_index"]: row for row in rows if isinstance(row.get("episode_index"), int)}
    found = {}
    for file in sorted((path / "meta/episodes").glob("chunk-*/*.parquet")):
        table = _read_parquet_table(file)
        wanted = {key: values for key, values in table.items() if key.startswith(("videos/", "length"))}
        for k, number in enumerate(table["episode_index"]):
            found[int(number)] = {key: values[k] for key, values in wanted.items()}
    return found


def _json_lines(file: Path) -> list[dict[str, Any]]:
    if not file.is_file():
        return []
    try:
        if file.stat().st_size > _MAX_JSONL_BYTES:
            raise DatasetError(f"{file}: has {file.stat().st_size} bytes; valid: up to {_MAX_JSONL_BYTES}")
        rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file} cannot be read: {error}") from error
    return [row for row in rows if isinstance(row, dict)]


def _video_jpegs(
    videos: VideoPaths, key: str, number: int, row: Mapping[str, Any] | None, frames: int
) -> Iterator[bytes]:
    file, begin = videos.locate_video(key, number, row)
    count = 0
    for image in read_video_frames(file, begin, frames, 0.5 / videos.fps):
        count += 1
        yield encode_jpeg(image, JPEG_QUALITY)
    if count != frames:
        raise DatasetError(
            f"{file}: has {count} images of episode {number} from {begin:.3f} s on, and the episode has {frames} rows"
        )


def _row_jpegs(rows: Sequence[Any], source: str) -> Iterator[bytes]:
    for k, row in enumerate(rows):
        data = row.get("bytes") if isinstance(row, dict) else None
        image = decode_image(data) if isinstance(data, bytes) else None
        if image is None or not isinstance(data, bytes):
            raise DatasetError(f"{source}: row {k} has no complete image; copy it again")
        yield data if data.startswith(_JPEG_START) else encode_jpeg(image, JPEG_QUALITY)
