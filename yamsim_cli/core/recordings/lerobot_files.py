"""LeRobot datasets of YAM arms, versions 2.0 to 3.0: rows in Parquet, pictures in MP4 or in the rows.

Source: lerobot 0.4.4 and 0.6.1: `meta/info.json` with `codebase_version`, `video_path`, `features`; of v2, a Parquet
file and an MP4 an episode; of v3, several episodes in each, found by `meta/episodes/`.
"""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..config.real import GripperUnit
from ..config.rig import RigConfig
from ..errors import DatasetError, ResourceError
from ..geometry.se3 import Array
from ..images.image_files import decode_image
from ..images.jpeg import encode_jpeg
from ..images.video import film_frames
from ..motion import Motion
from ..resources import Locations
from .lerobot_films import Films
from .naming import arms_of, naming_of
from .recording import Pictures, Recording
from .times import from_seconds

INFO = "meta/info.json"
_STATE, _ACTION, _PICTURE = "observation.state", "action", "observation.images."
# What yamsim's own export of real recordings adds: the times at which frames were recorded, and the grippers' unit.
_OWN_TIME, _OWN_FILE, _OWN_UNIT = "recorded_time", "meta/yamsim.json", "gripper"
_QUALITY = 95
_JPEG_START = b"\xff\xd8"
_MOST_BYTES = 1 << 26


@dataclass(frozen=True)
class _Source:
    """A dataset: its folder, what `info.json` says, the rig, and the user's own naming."""

    path: Path
    info: Mapping[str, Any]
    rig: RigConfig
    mapping: str | None
    locations: Locations

    @property
    def films(self) -> Films:
        """Where the videos of this dataset are."""
        return Films(self.path, self.info, INFO)

    def feature_names(self, key: str, width: int) -> list[str]:
        """The names of a feature's columns, which some programs put into a list or under a word."""
        feature = self.info["features"].get(key, {})
        names = feature.get("names")
        if isinstance(names, dict):
            names = next(iter(names.values()), None)
        if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
            names = names[0]
        if not isinstance(names, list) or len(names) != width or not all(isinstance(name, str) for name in names):
            raise DatasetError(f"{self.path / INFO}: {key}: names are {names!r}; valid: {width} names in a list")
        return names

    @property
    def gripper(self) -> GripperUnit | None:
        """The unit of grippers where yamsim wrote the dataset and said it."""
        try:
            said = json.loads((self.path / _OWN_FILE).read_bytes())
        except (OSError, ValueError):
            return None
        unit = said.get(_OWN_UNIT) if isinstance(said, dict) else None
        return unit if unit in get_args(GripperUnit) else None

    def cameras(self, kind: str) -> list[str]:
        """The cameras that have a `video`, or an `image` in each row."""
        features = self.info["features"]
        described = {key: value for key, value in features.items() if isinstance(value, dict)}
        return [key for key, value in described.items() if key.startswith(_PICTURE) and value.get("dtype") == kind]


def read_lerobot(path: Path, rig: RigConfig, mapping: str | None, locations: Locations) -> list[Recording]:
    """The episodes of a LeRobot dataset.

    Args:
        mapping: a naming of `configs/recordings/` or a YAML of the user's; None for the first that fits.

    Raises:
        DatasetError: it is damaged, of another version, or no naming fits.
        ResourceError: pyarrow is not installed.
    """
    try:
        info = json.loads((path / INFO).read_bytes())
        version, features = str(info["codebase_version"]), info["features"]
    except OSError as error:
        raise DatasetError(f"{path / INFO} cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path / INFO}: is no LeRobot dataset's: {error}") from error
    if not isinstance(features, dict) or version.split(".")[0] not in ("v2", "v3"):
        raise DatasetError(f"{path / INFO}: codebase_version is {version!r}; valid: v2.0, v2.1 and v3.0")
    source = _Source(path, info, rig, mapping, locations)
    if source.cameras("video"):
        source.films.check()
    tasks = _tasks(path)
    rows = _episode_rows(path) if version.startswith("v3") else {}
    lengths = {number: row.get("length") for number, row in rows.items()} or _lengths(path)
    recordings = []
    for number, table in _episodes(path):
        if (said := lengths.get(number)) is not None and said != (held := len(table["episode_index"])):
            raise DatasetError(f"{path} episode {number}: has {held} rows, and meta/ says {said}: was it cut off?")
        recordings.append(_recording(source, number, table, tasks, rows.get(number)))
    if not recordings:
        raise DatasetError(f"{path}/data: holds no episode")
    return recordings


def _recording(
    source: _Source, number: int, table: Mapping[str, Any], tasks: Mapping[int, str], row: Mapping[str, Any] | None
) -> Recording:
    name = f"{source.path} episode {number}"
    if _STATE not in table:
        raise DatasetError(f"{name}: has no {_STATE}; its columns are {', '.join(table)}")
    measured, told = _rows(table, _STATE, name), _rows(table, _ACTION, name) if _ACTION in table else None
    columns = source.feature_names(_STATE, measured.shape[1])
    names = naming_of(columns, source.rig, source.mapping, name, source.locations)
    commanded = None
    if told is not None:
        others = source.feature_names(_ACTION, told.shape[1])
        needed = [one for arm in names.arms.values() for one in (*arm.joints, *([arm.gripper] if arm.gripper else []))]
        # An action of something else, such as poses of hands, is none that drives were told.
        commanded = dict(zip(others, told.T, strict=True)) if set(needed) <= set(others) else None
    stamps = table.get(_OWN_TIME, table["timestamp"])
    times = from_seconds(np.asarray(stamps, dtype=np.float64).ravel(), name)
    arms = arms_of(names, source.rig, dict(zip(columns, measured.T, strict=True)), commanded)
    samples = np.arange(len(times), dtype=np.int64)
    made: dict[str, Callable[[], Iterator[bytes]]] = {
        key: functools.partial(_jpegs, source, key, number, row, len(times)) for key in source.cameras("video")
    }
    made |= {
        key: functools.partial(_stored, table[key], f"{name}: {key}") for key in source.cameras("image") if key in table
    }
    pictures = {key.removeprefix(_PICTURE).replace(".", "_"): Pictures(samples, read) for key, read in made.items()}
    task = int(np.asarray(table["task_index"]).ravel()[0]) if "task_index" in table else -1
    return Recording(Motion(name, times, arms), source.gripper or names.gripper, pictures, tasks.get(task, ""))


def _rows(table: Mapping[str, Any], key: str, name: str) -> Array:
    try:
        rows = np.array([np.asarray(row, dtype=np.float64).ravel() for row in table[key]])
    except (ValueError, TypeError) as error:
        raise DatasetError(f"{name}: {key} holds no rows of numbers: {error}") from error
    if rows.ndim != 2 or not np.isfinite(rows).all():
        raise DatasetError(
            f"{name}: {key} is {rows.shape} with {np.count_nonzero(~np.isfinite(rows))} that are no numbers"
        )
    return rows


def _episodes(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Number and columns of each episode, in order. Those of v3 may share a file, and one may go on in the next."""
    unfinished: tuple[int, dict[str, list[Any]]] | None = None
    for file in sorted((path / "data").glob("chunk-*/*.parquet")):
        table = _table(file)
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


def _table(file: Path) -> dict[str, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise ResourceError(
            "a LeRobot dataset needs pyarrow, which is not here: pip install 'yamsim[lerobot]'"
        ) from error
    try:
        return {str(key): values for key, values in pyarrow.parquet.read_table(file).to_pydict().items()}
    except (OSError, pyarrow.ArrowException) as error:
        raise DatasetError(f"{file} cannot be read: {error}; was it copied whole?") from error


def _tasks(path: Path) -> dict[int, str]:
    """Number of a task -> the task in words."""
    parquet, lines = path / "meta/tasks.parquet", path / "meta/tasks.jsonl"
    if parquet.is_file():
        table = _table(parquet)
        words: list[Any] = next((table[key] for key in ("task", "__index_level_0__") if key in table), [])
        return {int(number): str(word) for number, word in zip(table.get("task_index", []), words, strict=False)}
    found = {}
    for row in _json_lines(lines) if lines.is_file() else []:
        if isinstance(row.get("task_index"), int):
            found[row["task_index"]] = str(row.get("task", ""))
    return found


def _lengths(path: Path) -> dict[int, Any]:
    """Episode -> how many rows version 2 says that it has."""
    lines = path / "meta/episodes.jsonl"
    rows = _json_lines(lines) if lines.is_file() else []
    return {row["episode_index"]: row.get("length") for row in rows if isinstance(row.get("episode_index"), int)}


def _json_lines(file: Path) -> list[dict[str, Any]]:
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise DatasetError(f"{file}: has {file.stat().st_size} bytes; valid: up to {_MOST_BYTES}")
        rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file} cannot be read: {error}") from error
    return [row for row in rows if isinstance(row, dict)]


def _episode_rows(path: Path) -> dict[int, dict[str, Any]]:
    """Episode -> its row in `meta/episodes/`, which says where its films are."""
    found = {}
    for file in sorted((path / "meta/episodes").glob("chunk-*/*.parquet")):
        table = _table(file)
        for k, number in enumerate(table["episode_index"]):
            found[int(number)] = {
                key: values[k] for key, values in table.items() if key.startswith(("videos/", "length"))
            }
    return found


def _jpegs(source: _Source, key: str, number: int, row: Mapping[str, Any] | None, frames: int) -> Iterator[bytes]:
    """The pictures of an episode."""
    file, begin = source.films.place(key, number, row)
    count = 0
    for image in film_frames(file, begin, frames, 0.5 / source.films.fps):
        count += 1
        yield encode_jpeg(image, _QUALITY)
    if count != frames:
        raise DatasetError(
            f"{file}: has {count} pictures of episode {number} from {begin:.3f} s on, and it {frames} rows"
        )


def _stored(rows: Sequence[Any], source: str) -> Iterator[bytes]:
    """The pictures that rows hold as PNG or JPEG."""
    for k, row in enumerate(rows):
        data = row.get("bytes") if isinstance(row, dict) else None
        image = decode_image(data) if isinstance(data, bytes) else None
        if image is None or not isinstance(data, bytes):
            raise DatasetError(f"{source}: row {k} holds no whole picture; was it copied whole?")
        yield data if data.startswith(_JPEG_START) else encode_jpeg(image, _QUALITY)


def is_lerobot(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (path / INFO).is_file()
