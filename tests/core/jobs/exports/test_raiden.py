"""The real stack's layout: held against its schema, and read as the real stack's users read it."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.core.jobs.exports.conftest import EPISODES
from tests.core.jobs.exports.raiden_diff import differences
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.errors import DatasetError, PartialJobError, UsageError
from yamsim_cli.core.jobs.exports.raiden import export_raiden
from yamsim_cli.core.jobs.exports.source import open_source
from yamsim_cli.core.resources import Locations

FRAMES = 57


@pytest.fixture(scope="module")
def export(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("raiden") / "out"
    steps: list[tuple[int, int]] = []
    done = export_raiden(open_source(dataset, None, locations), out, locations, lambda *step: steps.append(step))
    assert (done.episodes, done.frames, done.moved_aside) == (EPISODES, EPISODES * FRAMES, None)
    assert steps == [(1, 3), (2, 3), (3, 3)]
    return out


def test_nothing_is_missing_and_nothing_is_too_much(export: Path) -> None:
    assert differences(export) == []
    assert [path.name for path in export.parent.iterdir()] == ["out"], "something is left of the work"


def test_depth_is_exported_where_there_is_any(dataset_with_depth: Path, locations: Locations, tmp_path: Path) -> None:
    export_raiden(open_source(dataset_with_depth, None, locations), tmp_path / "out", locations, lambda *_: None)
    assert differences(tmp_path / "out") == []
    metadata = json.loads((tmp_path / "out" / "0000" / "metadata.json").read_text())
    assert metadata["labels"] == ["rgb", "depth", "action", "language"]
    with np.load(tmp_path / "out" / "0000" / "depth" / "scene_camera" / "0000000012.npz") as archive:
        assert archive["depth"].dtype == np.uint16
        assert archive["depth"][0, 0] == 712


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda root: (root / "0001" / "lowdim" / "0000000007.pkl").unlink(), "lowdim/0000000007.pkl is missing"),
        (lambda root: (root / "0002" / "rgb" / "scene_camera" / "x.jpg").write_bytes(b""), "x.jpg is too much"),
        (lambda root: (root / "calibration_results.json").unlink(), "calibration_results.json is missing"),
        (lambda root: _change(root, joints=np.zeros(7, np.float32)), "joints is float32 (7,), not float32 (14,)"),
        (lambda root: _change(root, action=np.zeros(26)), "action is float64 (26,), not float32 (26,)"),
        (lambda root: _change(root, magnet=True), "keys are"),
    ],
)
def test_the_schema_tells_what_differs(damage: object, told: str, export: Path, tmp_path: Path) -> None:
    root = shutil.copytree(export, tmp_path / "copy")
    damage(root)  # type: ignore[operator]
    try:
        found = differences(root)
    except FileNotFoundError as error:
        found = [f"{Path(error.filename).name} is missing"]
    assert any(told in text for text in found), found


def _change(root: Path, **values: object) -> None:
    file = root / "0000" / "lowdim" / "0000000003.pkl"
    file.write_bytes(pickle.dumps(pickle.loads(file.read_bytes()) | values))


def test_frames_hold_what_was_recorded(dataset: Path, export: Path) -> None:
    """A lone arm is the left one, its wrist camera too, in its own base; grippers are a share of the opening."""
    for k in (0, 20, 56):
        was = load_frame((dataset / "ep_000001" / "lowdim" / f"{k:06d}.pkl").read_bytes())
        frame = pickle.loads((export / "0001" / "lowdim" / f"{k:010d}.pkl").read_bytes())
        for key, recorded in (("joints", "joints"), ("action_joints", "action_joints")):
            np.testing.assert_array_equal(frame[key][:6], was[recorded][:6])
            np.testing.assert_allclose(frame[key][6], was[recorded][6] / 0.037524, atol=1e-6)
            np.testing.assert_array_equal(frame[key][7:], 0)
        np.testing.assert_array_equal(frame["extrinsics"]["left_wrist_camera"], was["extrinsics"]["right_wrist_camera"])
        np.testing.assert_array_equal(frame["intrinsics"]["scene_camera"], was["intrinsics"]["scene_camera"])
        # Kinematics of the joints is where the simulation had the hand.
        np.testing.assert_allclose(frame["actual_poses"][:3], was["ee_pose"][:3, 3], atol=1e-6)
        np.testing.assert_allclose(frame["actual_poses"][3:12].reshape(3, 3), was["ee_pose"][:3, :3], atol=1e-6)
        assert (frame["language_task"], frame["language_prompt"]) == (was["language_task"], was["language_prompt"])


def test_commanded_poses_run_ahead_of_the_arm(export: Path) -> None:
    frames = [pickle.loads(file.read_bytes()) for file in sorted((export / "0000" / "lowdim").iterdir())]
    command, reached = (np.array([frame[key][:3] for frame in frames]) for key in ("action", "actual_poses"))
    # A command is for the end of the first of a frame's two control ticks.
    halfway = (reached[:-1] + reached[1:]) / 2
    ahead, here = (np.linalg.norm(command[:-1] - there, axis=1).sum() for there in (halfway, reached[:-1]))
    assert 0 < ahead < here / 2


def test_images_are_the_recorded_bytes_at_their_times(dataset: Path, export: Path) -> None:
    for camera, name in (("scene_camera", "scene_camera"), ("right_wrist_camera", "left_wrist_camera")):
        folder = export / "0002" / "rgb" / name
        for k in (0, 56):
            recorded = (dataset / "ep_000002" / "rgb" / camera / f"{k:06d}.jpg").read_bytes()
            assert (folder / f"{k:010d}.jpg").read_bytes() == recorded
        np.testing.assert_array_equal(np.load(folder / "timestamps.npy"), np.arange(FRAMES) * 64_000_000)


def test_the_calibration_puts_the_wrist_camera_where_its_frames_do(export: Path) -> None:
    """As the real stack computes it: kinematics times hand-eye."""
    hand_eye = json.loads((export / "calibration_results.json").read_text())["cameras"]["left_wrist_camera"]
    T_cam_in_hand = np.eye(4)
    T_cam_in_hand[:3, :3] = hand_eye["hand_eye_calibration"]["rotation_matrix"]
    T_cam_in_hand[:3, 3] = hand_eye["hand_eye_calibration"]["translation_vector"]
    for k in (0, 30):
        frame = pickle.loads((export / "0000" / "lowdim" / f"{k:010d}.pkl").read_bytes())
        hand = np.eye(4)
        hand[:3, 3], hand[:3, :3] = frame["actual_poses"][:3], frame["actual_poses"][3:12].reshape(3, 3)
        np.testing.assert_allclose(hand @ T_cam_in_hand, frame["extrinsics"]["left_wrist_camera"], atol=2e-6)


def test_an_altered_file_stops_the_export_and_leaves_nothing(
    dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    (copy / "ep_000002" / "rgb" / "scene_camera" / "000050.jpg").write_bytes(b"\xff\xd8\xff\xd9")
    with pytest.raises(DatasetError, match=r"000050\.jpg is not what was recorded"):
        export_raiden(open_source(copy, None, locations), tmp_path / "out", locations, lambda *_: None)
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]
    export_raiden(open_source(copy, "0-1", locations), tmp_path / "out", locations, lambda *_: None)
    assert differences(tmp_path / "out") == []


def test_what_is_in_the_way_stays_or_is_moved_aside(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("keep")
    source = open_source(dataset, "0", locations)
    with pytest.raises(UsageError, match="is not empty; move it aside with --overwrite"):
        export_raiden(source, out, locations, lambda *_: None)
    done = export_raiden(source, out, locations, lambda *_: None, overwrite=True)
    assert done.moved_aside is not None
    assert (done.moved_aside / "mine").read_text() == "keep"
    assert differences(out) == []
    with pytest.raises(UsageError, match="there is no directory"):
        export_raiden(source, tmp_path / "no" / "where", locations, lambda *_: None)


def test_a_full_disk_is_told_and_leaves_nothing(
    dataset: Path, locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("yamsim_cli.core.files._fsync", full)
    with pytest.raises(PartialJobError, match="nothing was exported"):
        export_raiden(open_source(dataset, "0", locations), tmp_path / "out", locations, lambda *_: None)
    assert list(tmp_path.iterdir()) == []
