"""Recordings of other programs come in as the motions that they hold."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet
import pytest

from tests.real.recordings.foreign import (
    PROMPT,
    grey_of,
    write_lerobot_v2,
    write_lerobot_v3,
    write_lowdim,
    write_raiden_raw,
)
from tests.real.recordings.making import same_motion, swinging
from tests.unrendered import write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.errors import ConfigError, DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.jpeg import decode_jpeg
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.lerobot import export_lerobot
from yamsim_cli.export.raiden import export_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions
from yamsim_cli.real.recordings.lerobot_files import VideoPaths
from yamsim_cli.real.recordings.motion_reading import detect_format, format_reader
from yamsim_cli.real.recordings.recording import Recording

_PATTERN = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_MISSING = object()


@pytest.fixture(scope="module")
def recorded(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "dataset"
    write_dataset(path, make_config(), locations, 2)
    return path


def only(path: Path, rig: RigConfig, locations: Locations, mapping: str | None = None) -> Recording:
    (recording,) = format_reader(detect_format(path))(path, rig, mapping, locations)
    return recording


@pytest.mark.parametrize("name", ["single", "station"])
def test_raidens_raw_recordings(
    name: str, locations: Locations, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    rig: RigConfig = request.getfixturevalue(name)
    motion = swinging(rig, 1.0)
    folder = write_raiden_raw(tmp_path / "raw", motion, rig)
    assert detect_format(folder) == detect_format(folder / "robot_data.npz") == "raiden_raw"
    recording = only(folder, rig, locations)
    assert (recording.gripper, recording.prompt) == ("share", PROMPT)
    same_motion(recording.motion_in_metres(rig), motion)


def test_a_raw_recording_of_other_arms_is_refused(
    single: RigConfig, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    lone = write_raiden_raw(tmp_path / "lone", swinging(single, 0.5), single)
    with pytest.raises(DatasetError, match="has no follower_r_joint_pos_7d"):
        only(lone, station, locations)
    both = write_raiden_raw(tmp_path / "both", swinging(station, 0.5), station)
    with pytest.raises(DatasetError, match="holds 2 followers"):
        only(both, single, locations)


def test_pickles_in_a_raw_recording_are_refused(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_raiden_raw(tmp_path / "raw", swinging(station, 0.5), station)
    np.savez(folder / "robot_data.npz", timestamps=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DatasetError, match="cannot be read"):
        only(folder, station, locations)


def test_lerobot_version_2_with_its_film(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    motion = swinging(station, 0.5)
    folder = write_lerobot_v2(tmp_path / "two", motion, station)
    recording = only(folder, station, locations)
    same_motion(recording.motion_in_metres(station), motion)
    assert recording.prompt == PROMPT
    pictures = [decode_jpeg(data) for data in recording.pictures["top"].read()]
    assert len(pictures) == len(motion.times)
    for k, picture in enumerate(pictures):
        assert picture is not None
        assert abs(float(picture.mean()) - grey_of(k)) < 3


def test_lerobot_with_a_picture_in_each_row(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_lerobot_v2(tmp_path / "two", swinging(station, 0.1), station)
    info = json.loads((folder / "meta/info.json").read_text())
    info["features"]["observation.images.top"]["dtype"] = "image"
    (folder / "meta/info.json").write_text(json.dumps(info))
    (file,) = (folder / "data").glob("**/*.parquet")
    table = pyarrow.parquet.read_table(file)
    pictures = [cv2.imencode(".png", np.full((48, 64, 3), grey_of(k), np.uint8))[1].tobytes() for k in range(10)]
    held = table.append_column("observation.images.top", [[{"bytes": data, "path": None} for data in pictures]])
    pyarrow.parquet.write_table(held, file)
    found = [decode_jpeg(data) for data in only(folder, station, locations).pictures["top"].read()]
    np.testing.assert_allclose([picture.mean() for picture in found if picture is not None], [*map(grey_of, range(10))])
    pictures[4] = pictures[4][:-20]
    held = table.append_column("observation.images.top", [[{"bytes": data, "path": None} for data in pictures]])
    pyarrow.parquet.write_table(held, file)
    with pytest.raises(DatasetError, match=r"observation\.images\.top: row 4 has no complete image"):
        list(only(folder, station, locations).pictures["top"].read())


def test_unknown_names_need_a_mapping(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    motion = swinging(station, 0.3)
    folder = write_lerobot_v2(tmp_path / "two", motion, station, [f"motor{k}" for k in range(14)])
    with pytest.raises(DatasetError, match="--mapping"):
        only(folder, station, locations)
    arms = {
        side: {"joints": [f"motor{7 * k + j}" for j in range(6)], "gripper": f"motor{7 * k + 6}"}
        for k, side in enumerate(("left", "right"))
    }
    mapping = tmp_path / "mine.yaml"
    mapping.write_text(json.dumps({"name": "mine", "arms": arms}))
    same_motion(only(folder, station, locations, str(mapping)).motion_in_metres(station), motion)
    arms["left"]["joints"][2] = "elbow"
    mapping.write_text(json.dumps({"name": "mine", "arms": arms}))
    with pytest.raises(ConfigError, match="has no 'elbow'"):
        only(folder, station, locations, str(mapping))


def test_our_own_export_to_lerobot_comes_back(
    recorded: Path, config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    export_lerobot(open_source(recorded, None, locations), tmp_path / "lerobot", lambda done, total: None)
    back = format_reader("lerobot")(tmp_path / "lerobot", config.rig, None, locations)
    assert len(back) == 2
    for number, recording in enumerate(back):
        frames = open_episode(recorded / f"ep_{number:06d}").frames()
        (arm,) = recording.motion_in_metres(config.rig).arms
        np.testing.assert_allclose(arm.joints, [frame["joints"][:6] for frame in frames], atol=1e-6)
        np.testing.assert_allclose(arm.openings, [frame["joints"][6] for frame in frames], atol=1e-6)  # type: ignore[arg-type]
        np.testing.assert_allclose(arm.commands, [frame["ctrl"][:6] for frame in frames], atol=1e-6)  # type: ignore[arg-type]
        assert len(list(recording.pictures["scene_camera"].read())) == len(frames)


def test_the_layout_of_raidens_converter(
    recorded: Path, config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    options = RaidenOptions(fps=None, images="png")
    export_raiden(
        open_source(recorded, "0", locations), tmp_path / "raiden", locations, lambda done, total: None, options
    )
    (folder,) = (path.parent for path in (tmp_path / "raiden").glob("**/lowdim"))
    assert detect_format(folder) == "lowdim"
    recording = only(folder, config.rig, locations)
    frames = open_episode(recorded / "ep_000000").frames()
    assert recording.gripper == "share"
    motion = recording.motion_in_metres(config.rig)
    (arm,) = motion.arms
    np.testing.assert_allclose(
        motion.times, [frame["timestamp"] - frames[0]["timestamp"] for frame in frames], atol=1e-6
    )
    np.testing.assert_allclose(arm.joints, [frame["joints"][:6] for frame in frames], atol=1e-6)
    np.testing.assert_allclose(arm.openings, [frame["joints"][6] for frame in frames], atol=1e-4)  # type: ignore[arg-type]
    assert set(recording.intrinsics) == set(recording.extrinsics) == set(recording.pictures)
    images = next(iter(recording.pictures.values())).read()
    assert all(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None for data in images)


def test_a_camera_that_raiden_did_not_calibrate_has_no_place(
    station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    """Its converter writes the identity then, which would put the camera into the arm's base."""
    folder = write_lowdim(tmp_path / "one", swinging(station, 0.1), station)
    for file in (folder / "lowdim").iterdir():
        frame = pickle.loads(file.read_bytes())
        frame |= {
            "intrinsics": {"scene_camera": np.diag([600.0, 600.0, 1.0])},
            "extrinsics": {"scene_camera": np.eye(4)},
        }
        file.write_bytes(pickle.dumps(frame))
    recording = only(folder, station, locations)
    assert set(recording.intrinsics) == {"scene_camera"}
    assert recording.extrinsics == {}


def test_recordings_that_raiden_marks_as_incomplete_are_reported(
    station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    folder = write_raiden_raw(tmp_path / "raw", swinging(station, 0.5), station)
    assert only(folder, station, locations).problems == ()
    (folder / "metadata.json").write_text(json.dumps({"complete": False}))
    (problem,) = only(folder, station, locations).problems
    assert "says that it is not complete" in problem
    other = write_lowdim(tmp_path / "one", swinging(station, 0.1), station)
    (other / "metadata.json").write_text(json.dumps({"num_frames": 12}))
    (problem,) = only(other, station, locations).problems
    assert "there are 10 frames" in problem


@pytest.mark.parametrize("version", ["v2", "v3"])
def test_episodes_with_fewer_rows_than_they_say(
    version: str, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    write = {"v2": write_lerobot_v2, "v3": write_lerobot_v3}[version]
    folder = write(tmp_path / "one", swinging(station, 0.3), station)
    (file,) = (folder / "data").glob("**/*.parquet")
    pyarrow.parquet.write_table(pyarrow.parquet.read_table(file).slice(0, 20), file)
    with pytest.raises(
        DatasetError, match=r"episode 0: has 20 rows, and meta/ says 30; it was probably cut off: copy it again"
    ):
        only(folder, station, locations)


def test_the_labs_own_layout(recorded: Path, config: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    """As yamsim's recording without its records."""
    for folder in ("rgb", "lowdim"):
        (tmp_path / "lab" / "ep1").mkdir(parents=True, exist_ok=True)
        (tmp_path / "lab" / "ep1" / folder).symlink_to(recorded / "ep_000001" / folder)
    recording = only(tmp_path / "lab", config.rig, locations)
    frames = open_episode(recorded / "ep_000001").frames()
    assert recording.gripper == "metres"
    (arm,) = recording.motion.arms
    np.testing.assert_allclose(arm.joints, [frame["joints"][:6] for frame in frames], atol=1e-6)
    first = next(recording.pictures["scene_camera"].read())
    assert first == (recorded / "ep_000001" / "rgb/scene_camera/000000.jpg").read_bytes()


@pytest.mark.parametrize("value", [_MISSING, 0, -30, "30", True, float("nan"), None])
@pytest.mark.parametrize("key", ["fps", "video_path", "chunks_size"])
def test_a_missing_or_wrong_value_is_a_dataset_error(key: str, value: Any) -> None:
    info = {"fps": 30, "video_path": _PATTERN} | {key: value}
    if value is _MISSING:
        del info[key]
    if (key, value) in (("video_path", "30"), ("chunks_size", _MISSING)):
        return  # A pattern without fields and the default size are valid.
    with pytest.raises(DatasetError, match=rf"info.json: {key} .*valid: "):
        VideoPaths(Path("set"), info).check_metadata()


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
        "videos/{file_index:03d}.mp4",
    ],
)
def test_a_foreign_pattern_is_refused_before_it_is_formatted(pattern: str) -> None:
    films = VideoPaths(Path("set"), {"fps": 30, "video_path": pattern})
    with pytest.raises(DatasetError, match=r"video_path is .*valid: "):
        films.locate_video("observation.images.top", 0, None)


def test_a_row_of_version_3_without_a_place_is_a_dataset_error() -> None:
    pattern = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    films = VideoPaths(Path("set"), {"fps": 30, "video_path": pattern})
    row = {"videos/k/chunk_index": 0, "videos/k/file_index": 2, "videos/k/from_timestamp": 1.5}
    assert films.locate_video("k", 0, row) == (Path("set/videos/k/chunk-000/file-002.mp4").resolve(), 1.5)
    for key in row:
        for wrong in (None, -1, "0"):
            with pytest.raises(DatasetError, match="episode 0: "):
                films.locate_video("k", 0, row | {key: wrong})


def test_videos_are_checked_when_a_dataset_is_read(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_lerobot_v2(tmp_path / "two", swinging(station, 0.1), station)
    info = json.loads((folder / "meta/info.json").read_text())
    (folder / "meta/info.json").write_text(json.dumps(info | {"fps": None}))
    with pytest.raises(DatasetError, match=r"fps is None; valid: "):
        format_reader("lerobot")(folder, station, None, locations)
    features = info["features"] | {"observation.images.a/b": info["features"].pop("observation.images.top")}
    (folder / "meta/info.json").write_text(json.dumps(info | {"features": features}))
    with pytest.raises(DatasetError, match="camera 'a/b' is not valid"):
        format_reader("lerobot")(folder, station, None, locations)
