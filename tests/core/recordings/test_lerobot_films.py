"""What `meta/info.json` of a LeRobot dataset may say of videos."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.core.recordings.foreign import write_lerobot_v2
from tests.core.recordings.making import swinging
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.recordings.lerobot_files import VideoPaths
from yamsim_cli.core.recordings.reading import reader_of
from yamsim_cli.core.resources import Locations

_NAMES = [f"{side}_{what}" for side in ("left", "right") for what in (*(f"joint_{k}" for k in range(1, 7)), "gripper")]
_PATTERN = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_MISSING = object()


@pytest.fixture(scope="module")
def station(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "yam_station_linear_4310_d405", locations)


@pytest.mark.parametrize("value", [_MISSING, 0, -30, "30", True, float("nan"), None])
@pytest.mark.parametrize("key", ["fps", "video_path"])
def test_a_value_that_is_missing_or_wrong_is_a_dataset_error(key: str, value: Any) -> None:
    info: dict[str, Any] = {"fps": 30, "video_path": _PATTERN}
    info[key] = value
    if value is _MISSING:
        del info[key]
    if (key, value) == ("video_path", "30"):
        return  # A file without fields is an odd path, but a path.
    with pytest.raises(DatasetError, match=rf"info.json: {key} .*valid: "):
        VideoPaths(Path("set"), info).check()


@pytest.mark.parametrize(
    "pattern",
    [
        "videos/{episode_index:999999999d}.mp4",
        "videos/{episode_index:{episode_chunk}d}.mp4",
        "videos/{video_key:999999999}.mp4",
        "videos/{video_key.__class__}.mp4",
        "videos/{video_key[0]}.mp4",
        "videos/{episode_index!r}.mp4",
        "videos/{0}.mp4",
        "videos/{}.mp4",
        "videos/{other}.mp4",
        "videos/{episode_index",
        "videos/{episode_index:.6f}.mp4",
        "x" * 2000,
        "videos/\0.mp4",
    ],
)
def test_a_foreign_pattern_is_refused_before_it_is_formatted(pattern: str) -> None:
    films = VideoPaths(Path("set"), {"fps": 30, "video_path": pattern})
    with pytest.raises(DatasetError, match=r"video_path is .*valid: "):
        films.locate("observation.images.top", 0, None)


@pytest.mark.parametrize("value", [0, -1, "1000", 1.5])
def test_a_wrong_chunk_size_is_a_dataset_error(value: Any) -> None:
    films = VideoPaths(Path("set"), {"fps": 30, "video_path": _PATTERN, "chunks_size": value})
    with pytest.raises(DatasetError, match="chunks_size is "):
        films.locate("observation.images.top", 0, None)


def test_a_row_of_version_3_without_a_place_is_a_dataset_error() -> None:
    pattern = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    films = VideoPaths(Path("set"), {"fps": 30, "video_path": pattern})
    row = {"videos/k/chunk_index": 0, "videos/k/file_index": 2, "videos/k/from_timestamp": 1.5}
    assert films.locate("k", 0, row) == (Path("set/videos/k/chunk-000/file-002.mp4").resolve(), 1.5)
    for key in row:
        for wrong in (None, -1, "0"):
            with pytest.raises(DatasetError, match="episode 0: "):
                films.locate("k", 0, row | {key: wrong})


def test_a_pattern_of_the_other_version_is_a_dataset_error() -> None:
    films = VideoPaths(Path("set"), {"fps": 30, "video_path": "videos/{file_index:03d}.mp4"})
    with pytest.raises(DatasetError, match=r"video_path .*valid: for this version"):
        films.locate("k", 0, None)


@pytest.mark.parametrize("key", ["fps", "video_path"])
def test_a_dataset_without_a_needed_value_is_refused_when_it_is_read(
    station: RigConfig, locations: Locations, tmp_path: Path, key: str
) -> None:
    folder = write_lerobot_v2(tmp_path / "two", swinging(station, 0.1), station, _NAMES)
    info = json.loads((folder / "meta/info.json").read_text())
    del info[key]
    (folder / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(DatasetError, match=rf"{key} is missing; valid: "):
        reader_of("lerobot")(folder, station, None, locations)


def test_a_camera_with_a_path_as_its_name_is_refused(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_lerobot_v2(tmp_path / "two", swinging(station, 0.1), station, _NAMES)
    info = json.loads((folder / "meta/info.json").read_text())
    info["features"]["observation.images.a/b"] = info["features"].pop("observation.images.top")
    (folder / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(DatasetError, match="camera 'a/b' is not valid"):
        reader_of("lerobot")(folder, station, None, locations)
