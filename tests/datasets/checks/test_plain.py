"""Recordings of other programs: rgb/ and lowdim/ alone are checked as far as possible."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.datasets.checks.sample import CAMERA, FRAMES, SampleDataset, black, picture
from yamsim_cli.core.dataset.checks.context import ArmLimits
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.datasets.checks.motion import ArmData, angles_by_camera, read_timestamps

PLAIN = ("dataset.plain", "", "")
FRAME = "lowdim/000002.pkl"


def station(frame: dict[str, Any]) -> dict[str, Any]:
    """A frame of the two-arm station: joints of both arms, matrices, actions and text; no time, no object."""
    q = frame["joints"]
    actions = np.tile(np.concatenate([[0.3, 0, 0.2], np.eye(3).ravel(), [0.5]]), 2).astype(np.float32)
    return {
        "intrinsics": frame["intrinsics"],
        "extrinsics": frame["extrinsics"],
        "joints": np.concatenate([q, q]),
        "action": actions,
        "actual_poses": actions,
        "action_joints": np.concatenate([q, q]),
        "language_task": "fold",
        "language_prompt": "fold the towel",
    }


def test_a_plain_recording_is_read_with_a_warning(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    found = survey_of(sample.write_plain(path))
    assert [(p.code, p.episode, p.file) for p in found.problems] == [PLAIN]
    assert [episode.name for episode in found.episodes] == ["0", "1", "2"]
    facts = found.episodes[1]
    assert facts.frames == FRAMES
    assert facts.cameras == {CAMERA: (64, 48)}
    assert facts.seconds == pytest.approx(5 * 0.064)
    assert facts.outcome.dxy_m == pytest.approx(0.002, abs=1e-6)
    assert facts.outcome.success
    assert facts.start_positions["banana"] == pytest.approx((0.35, -0.1))
    assert facts.end_positions["plate"] == pytest.approx((0.45, 0.08))


def test_a_station_with_two_arms_is_read_too(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    found = survey_of(sample.write_plain(path, station))
    assert [p.code for p in found.problems] == ["dataset.plain"]
    assert found.episodes[0].outcome is None
    assert found.episodes[0].start_positions == {}


def test_a_picture_that_stands_still_while_the_other_arm_moves(sample: SampleDataset, path: Path, found: Any) -> None:
    def right_alone(frame: dict[str, Any]) -> dict[str, Any]:
        data = station(frame)
        return data | {"joints": np.concatenate([data["action_joints"][:7] * 0 + 0.5, data["joints"][7:]])}

    sample.episodes[1].images[CAMERA] = [picture(0, 1)] * FRAMES
    assert "image.frozen" in {code for code, _, _ in found(sample.write_plain(path, right_alone))}


def test_names_with_more_digits_and_files_of_other_kinds_are_no_fault(
    sample: SampleDataset, path: Path, found: Any
) -> None:
    sample.write_plain(path)
    for file in [*path.rglob("*.pkl"), *path.rglob("*.jpg")]:
        file.rename(file.with_stem("0000" + file.stem))
    (path / "0/depth/scene").mkdir(parents=True)
    (path / "0/depth/scene/0000000000.npz").touch()
    (path / "0/metadata.json").write_text("{}")
    (path / "split_all.json").write_text("{}")
    assert found(path) == [PLAIN]


def test_numbers_may_begin_at_one(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write_plain(path)
    for folder in (path / "1/lowdim", path / f"1/rgb/{CAMERA}"):
        for file in sorted(folder.iterdir(), reverse=True):
            file.rename(file.with_stem(f"{int(file.stem) + 1:06d}"))
    assert found(path) == [PLAIN]


def spoil(change: Callable[[dict[str, Any]], object], k: int = 2) -> Callable[[SampleDataset], None]:
    def apply(sample: SampleDataset) -> None:
        change(sample.episodes[1].frames[k])

    return apply


DAMAGES: list[tuple[str, Callable[[SampleDataset], Any], str]] = [
    ("lowdim.missing", spoil(lambda f: f.pop("ctrl")), FRAME),
    ("lowdim.unexpected", spoil(lambda f: f.update(wind=1)), FRAME),
    ("lowdim.shape", spoil(lambda f: f.update(ctrl=f["ctrl"][:5])), FRAME),
    ("lowdim.type", spoil(lambda f: f.update(ctrl=f["ctrl"].astype(float))), FRAME),
    ("lowdim.finite", spoil(lambda f: f.update(ctrl=f["ctrl"] * np.float32("nan"))), FRAME),
    ("pose.rotation", spoil(lambda f: f.update(plate_pose=np.diag([2, 2, 2, 1]).astype(np.float32))), FRAME),
    ("joints.jump", spoil(lambda f: f.update(joints=f["joints"] + np.eye(7, dtype=np.float32)[0])), FRAME),
    ("joints.limit", spoil(lambda f: f.update(joints=np.degrees(f["joints"])), k=0), "lowdim/000000.pkl"),
    ("time.order", spoil(lambda f: f.update(timestamp=0.0)), FRAME),
    ("time.spacing", spoil(lambda f: f.update(timestamp=f["timestamp"] + 0.04)), FRAME),
    (
        "image.size",
        lambda s: s.episodes[1].images[CAMERA].__setitem__(2, picture(2, 1, (32, 24))),
        "rgb/scene_camera/000002.jpg",
    ),
    ("image.black", lambda s: s.episodes[1].images[CAMERA].__setitem__(2, black()), "rgb/scene_camera/000002.jpg"),
    (
        "image.frozen",
        lambda s: s.episodes[1].images.update({CAMERA: [picture(0, 1)] * FRAMES}),
        "rgb/scene_camera/000000.jpg",
    ),
    ("frames.count", lambda s: s.episodes[1].images[CAMERA].pop(), "rgb/scene_camera"),
]


@pytest.mark.parametrize(("code", "damage", "file"), DAMAGES, ids=[code for code, _, _ in DAMAGES])
def test_faults_are_found_without_a_record(
    sample: SampleDataset, path: Path, found: Any, code: str, damage: Callable[[SampleDataset], Any], file: str
) -> None:
    damage(sample)
    problems = found(sample.write_plain(path))
    assert problems[0] == PLAIN
    assert (code, "1", file) in problems
    # Degrees for radians leave further traces.
    assert {c for c, _, _ in problems[1:]} == {code} or code == "joints.limit"


@pytest.mark.parametrize("k", [100, 300, 600])
def test_a_damaged_image_is_found_by_what_the_decoder_says(
    sample: SampleDataset, path: Path, survey_of: Any, k: int
) -> None:
    """It decodes, and there is no hash: only libjpeg's warning reveals it."""
    sample.write_plain(path)
    file = path / f"1/rgb/{CAMERA}/000002.jpg"
    data = file.read_bytes()
    file.write_bytes(data[:-k] + data[-2:])
    problems = survey_of(path).problems
    assert [(p.code, p.file) for p in problems[1:]] == [("image.decode", f"rgb/{CAMERA}/000002.jpg")]
    assert "Corrupt JPEG data" in problems[1].text


def test_an_episode_there_twice_is_found(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write_plain(path)
    shutil.copytree(path / "0", path / "3")
    assert ("episode.duplicate", "3", "") in found(path)


def test_numbers_left_out_are_a_warning(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    sample.write_plain(path)
    shutil.rmtree(path / "1")
    (path / "2").rename(path / "9")
    (gap,) = (p for p in survey_of(path).problems if p.code == "episode.gap")
    assert gap.value == "1 to 8"


def test_times_beside_the_images_are_used(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    sample.write_plain(path, station)
    times = 1_700_000_000_000_000_000 + np.arange(FRAMES, dtype=np.int64) * 33_333_333
    for k in range(3):
        np.save(path / f"{k}/rgb/{CAMERA}/timestamps.npy", times)
    found = survey_of(path)
    assert [p.code for p in found.problems] == ["dataset.plain"]
    assert found.episodes[0].seconds == pytest.approx(5 / 30, rel=1e-6)
    np.save(path / f"1/rgb/{CAMERA}/timestamps.npy", times[::-1])
    np.save(path / f"2/rgb/{CAMERA}/timestamps.npy", times[:-1])
    assert [(p.code, p.episode) for p in survey_of(path).problems[1:]] == [("time.order", "1"), ("frames.count", "2")]


def test_a_time_file_that_lies_is_no_time_file(tmp_path: Path) -> None:
    file = tmp_path / "timestamps.npy"
    np.save(file, np.arange(4))
    data = file.read_bytes()
    assert read_timestamps(data) == pytest.approx([0.0, 1e-9, 2e-9, 3e-9])
    assert read_timestamps(data.replace(b"(4,), ", b"(4**9,")) is None
    assert read_timestamps(data.replace(b"(4,)", b"(9,)")) is None
    assert read_timestamps(data[:-1]) is None
    assert read_timestamps(data[:20]) is None
    assert read_timestamps(b"") is None
    np.save(file, np.array([{}]), allow_pickle=True)
    assert read_timestamps(file.read_bytes()) is None


@pytest.mark.parametrize("name", ["missing", "file", "empty", "0"])
def test_a_path_without_a_dataset_is_refused(sample: SampleDataset, path: Path, survey_of: Any, name: str) -> None:
    sample.write_plain(path)
    (path / "file").touch()
    (path / "empty").mkdir()
    said = (
        "is one episode; give the directory around it"
        if name == "0"
        else "give the directory that `yamsim record` wrote"
    )
    with pytest.raises(DatasetError, match=said):
        survey_of(path / name)


LIMITS = ArmLimits((), 3, None)
MOVING = ArmData(LIMITS, {k: np.array([0.1 * k, 0.0]) for k in range(4)}, {})
STILL = ArmData(LIMITS, {k: np.zeros(2) for k in range(4)}, {})


def test_a_wrist_camera_shows_the_motion_of_its_own_arm_alone() -> None:
    shown = angles_by_camera("right", [MOVING, STILL], {"left": 0, "right": 1})
    assert all(np.array_equal(shown[k], np.zeros(2)) for k in range(4))
    assert angles_by_camera("left", [MOVING, STILL], {"left": 0, "right": 1})[3][0] > 0.2


def test_any_other_camera_shows_all_arms() -> None:
    assert angles_by_camera("top", [MOVING, STILL], {"left": 0})[3].shape == (4,)
    assert angles_by_camera("top", [], {}) == {}
