"""Episodes of the maker's station program: written, and read again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from tests.export.conftest import EPISODES, frames_of, ignore
from tests.export.real_datasets import bring_in, of_tables
from tests.export.station_datasets import (
    CAMERAS,
    CODEC_ERROR,
    SIZE,
    image_error,
    images_of,
    motion_at,
    picture,
    station_dataset,
)
from tests.real.recordings.foreign import PROMPT, shares
from tests.real.recordings.making import same_motion
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.export.export_source import open_real_source, open_source
from yamsim_cli.export.maker import export_maker
from yamsim_cli.real.recordings.motion_reading import detect_format, format_reader, read_motions

ROLES = ("top", "left", "right")
TASK = PROMPT.replace(" ", "_")
KEYS = [f"{side}-{what}" for side in ("left", "right") for what in ("joint_pos", "gripper_pos")]
KEYS += [f"action-{side}-{what}" for side in ("left", "right") for what in ("joint", "gripper")]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Path:
    motions = [motion_at(station, 40), motion_at(station, 35)]
    return station_dataset(tmp_path_factory.mktemp("maker"), motions, station, locations)


@pytest.fixture(scope="module")
def exported(recorded: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("maker_out") / "out"
    done = export_maker(open_real_source(recorded, None, locations), out, ignore, workers=2)
    assert (done.episodes, done.frames, done.notes) == (2, 75, ())
    return out


def test_an_episode_has_the_makers_files(exported: Path, station: RigConfig) -> None:
    assert sorted(folder.name for folder in (exported / TASK).iterdir()) == ["ep_000000", "ep_000001"]
    folder = exported / TASK / "ep_000000"
    films = [f"{role}-images-rgb.mp4" for role in ROLES]
    arrays = [*KEYS, *[f"{role}-timestamp" for role in ROLES]]
    wanted = [*films, *[f"{key}.npy" for key in arrays], "metadata.json", "write_complete.flag"]
    assert sorted(file.name for file in folder.iterdir()) == sorted(wanted)
    measured, commanded = shares(motion_at(station, 40), station)
    for k, side in enumerate(("left", "right")):
        for (joints, gripper), rows in (
            ((f"{side}-joint_pos", f"{side}-gripper_pos"), measured[k]),
            ((f"action-{side}-joint", f"action-{side}-gripper"), commanded[k]),
        ):
            found = np.load(folder / f"{joints}.npy"), np.load(folder / f"{gripper}.npy")
            assert [rows.dtype for rows in found] == [np.float64, np.float64]
            assert [rows.shape for rows in found] == [(40, 6), (40, 1)]
            np.testing.assert_allclose(np.hstack(found), rows, atol=1e-6)
    np.testing.assert_allclose(np.load(folder / "left-timestamp.npy"), np.arange(40) / 0.03, atol=1e-4)
    with av.open(str(folder / "right-images-rgb.mp4")) as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.name, stream.width, stream.height) == ("h264", *SIZE)
        images = np.stack([frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)])
    assert image_error(images, np.stack([picture(2, k) for k in range(40)])) < CODEC_ERROR


def test_the_metadata_has_the_makers_fields(exported: Path) -> None:
    found = json.loads((exported / TASK / "ep_000001/metadata.json").read_text())
    camera = {"name": "left", "role": "left", "type": "unknown", "mode": "mono", "image_keys": ["rgb"]}
    camera |= {"width": SIZE[0], "height": SIZE[1], "fps": 30, "depth_scale": None}
    assert camera in found["cameras"]
    assert sorted(camera["role"] for camera in found["cameras"]) == sorted(ROLES)
    assert (found["schema_version"], found["task_name"], found["num_frames"]) == (1, PROMPT, 35)
    assert (found["arm_names"], found["num_arm_joints"], found["control_hz"]) == (["left", "right"], 6, 30)
    assert found["created_at"] == "1970-01-01T00:00:01"
    assert found["extra"]["yamsim"] == {"dataset": "real", "episode": "ep_000001", "source": "real"}


def test_a_round_trip_keeps_numbers_and_pictures(
    recorded: Path, exported: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    assert [detect_format(path) for path in (exported, exported / TASK, exported / TASK / "ep_000000")] == ["maker"] * 3
    again = bring_in(tmp_path / "again", [exported], station, locations)
    for found, wanted in zip(
        read_motions([again], station, locations), read_motions([recorded], station, locations), strict=True
    ):
        same_motion(found, wanted)
    for camera, role in zip(CAMERAS, ROLES, strict=True):
        assert image_error(images_of(again, 1, role), images_of(recorded, 1, camera)) < CODEC_ERROR


def test_one_process_writes_the_same_bytes_as_two(
    recorded: Path, exported: Path, locations: Locations, tmp_path: Path
) -> None:
    export_maker(open_real_source(recorded, None, locations), tmp_path / "out", ignore, workers=1)
    files = [file.relative_to(exported) for file in sorted(exported.rglob("*")) if file.is_file()]
    assert len(files) == 2 * 16
    for file in files:
        assert (tmp_path / "out" / file).read_bytes() == (exported / file).read_bytes()


def test_a_simulated_arm_becomes_the_left_one(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    done = export_maker(open_source(dataset, None, locations), tmp_path / "out", ignore)
    assert (done.episodes, done.frames) == (EPISODES, sum(frames_of(dataset)))
    assert done.notes == (
        "the dataset has 15.625 frames a second, which the maker's converters round to 16; `record --fps 30` records "
        "30",
    )
    (folder,) = tmp_path.glob("out/*/ep_000000")
    metadata = json.loads((folder / "metadata.json").read_text())
    assert metadata["arm_names"] == ["left"]
    assert sorted(camera["role"] for camera in metadata["cameras"]) == ["top", "wrist"]
    episode = open_episode(dataset / "ep_000000")
    frames = episode.frames()
    assert metadata["extra"]["yamsim"]["seed"] == episode.record.seed
    np.testing.assert_array_equal(np.load(folder / "left-joint_pos.npy"), [frame["joints"][:6] for frame in frames])
    np.testing.assert_array_equal(np.load(folder / "action-left-joint.npy"), [frame["ctrl"][:6] for frame in frames])
    gripper = np.load(folder / "left-gripper_pos.npy")
    assert gripper.min() >= 0 and gripper.max() <= 1 and np.ptp(gripper) > 0.3


def test_what_the_format_cannot_hold_is_refused(
    recorded: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    source = open_real_source(recorded, None, locations)
    with pytest.raises(UsageError, match="--top 'above' is not valid"):
        export_maker(source, tmp_path / "out", ignore, top="above")
    with pytest.raises(UsageError, match="give measured"):
        export_maker(source, tmp_path / "out", ignore, actions="none")
    assert not list(tmp_path.iterdir())


def test_another_camera_can_be_the_top_one(recorded: Path, locations: Locations, tmp_path: Path) -> None:
    export_maker(
        open_real_source(recorded, "0", locations), tmp_path / "out", ignore, top="left_wrist_camera", workers=1
    )
    (folder,) = tmp_path.glob("out/*/ep_000000")
    # The name `top` is taken, so the other camera keeps its own.
    assert {file.name for file in folder.glob("*.mp4")} == {
        f"{role}-images-rgb.mp4" for role in ("top", "right", "top_camera")
    }


def test_a_dataset_without_pictures_has_even_times(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    motion = motion_at(station, 30)
    tables = of_tables(tmp_path, [motion], station, locations)
    export_maker(open_real_source(tables, None, locations), tmp_path / "out", ignore)
    (recording,) = format_reader("maker")(tmp_path / "out", station, None, locations)
    same_motion(recording.motion_in_metres(station), motion)
    assert not recording.pictures


def cut_off(folder: Path) -> None:
    (folder / "write_complete.flag").unlink()


def fewer_rows(folder: Path) -> None:
    file = folder / "action-left-joint.npy"
    np.save(file, np.load(file)[:-3])


def other_arms(folder: Path) -> None:
    metadata = json.loads((folder / "metadata.json").read_text())
    (folder / "metadata.json").write_text(json.dumps(metadata | {"arm_names": ["left"]}))


def back_in_time(folder: Path) -> None:
    file = folder / "right-timestamp.npy"
    np.save(file, np.load(file)[::-1])


def fewer_images(folder: Path) -> None:
    shutil.copy(folder.parent / "ep_000001/top-images-rgb.mp4", folder / "top-images-rgb.mp4")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (cut_off, "ep_000000: has no write_complete.flag"),
        (fewer_rows, r"action-left-joint.npy: has the shape \(37, 6\); valid: \(40, 6\)"),
        (other_arms, "arm_names is .'left'., and rig .* has left and right"),
        (back_in_time, "the time of right goes back after image 0"),
        (fewer_images, "has 35 images for 40 samples"),
        (lambda folder: (folder / "metadata.json").write_text("{"), "metadata.json is not valid JSON"),
        (lambda folder: (folder / "left-joint_pos.npy").write_bytes(b"\x93NUMPY"), "is not a valid array file"),
    ],
)
def test_a_damaged_episode_is_refused_in_one_line(
    spoil: Callable[[Path], None],
    message: str,
    exported: Path,
    station: RigConfig,
    locations: Locations,
    tmp_path: Path,
) -> None:
    shutil.copytree(exported, tmp_path / "episodes")
    spoil(tmp_path / "episodes" / TASK / "ep_000000")
    with pytest.raises(DatasetError, match=message) as caught:
        bring_in(tmp_path / "real", [tmp_path / "episodes"], station, locations)
    assert "\n" not in str(caught.value)


def test_repeated_images_give_even_times_and_a_problem(
    exported: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    shutil.copytree(exported / TASK / "ep_000000", tmp_path / "one")
    times = np.load(tmp_path / "one/top-timestamp.npy")
    times[5] = times[4]
    np.save(tmp_path / "one/top-timestamp.npy", times)
    (recording,) = format_reader("maker")(tmp_path / "one", station, None, locations)
    same_motion(recording.motion_in_metres(station), motion_at(station, 40))
    assert recording.problems == ("1 of 40 images of top repeat the one before: it is slower than the arms",)
