"""raiden's layout: against its schema, and read as raiden's users read it."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.export.conftest import EPISODES, jpeg
from tests.export.raiden_diff import column, differences, frames_of
from tests.unrendered import SIZE, change_record, frame_count, write_dataset
from yamsim_cli.core.config.cameras.camera import CameraConfig
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.errors import DatasetError, PartialJobError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.core.robots.models import ArmModel
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.raiden import export_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions

# The recorded frames only; and at raiden's rate without rendering.
SOURCE = RaidenOptions(fps=None)
NEAREST = RaidenOptions(pictures="nearest")


def write(source: Path, out: Path, locations: Locations, options: RaidenOptions, episodes: str | None = None) -> Path:
    return export_raiden(open_source(source, episodes, locations), out, locations, lambda *_: None, options).path


@pytest.fixture(scope="module")
def export(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("raiden") / "out"
    steps: list[tuple[int, int]] = []
    source = open_source(dataset, None, locations)
    done = export_raiden(source, out, locations, lambda *step: steps.append(step), SOURCE)
    frames = [frame_count(dataset / f"ep_{k:06d}") for k in range(EPISODES)]
    assert (done.episodes, done.frames, done.moved_aside) == (EPISODES, sum(frames), None)
    assert steps == [(1, 3), (2, 3), (3, 3)]
    return out


def test_nothing_is_missing_and_nothing_is_too_much(export: Path) -> None:
    assert differences(export) == []
    assert [path.name for path in export.parent.iterdir()] == ["out"], "something is left of the work"


def test_depth_is_exported_where_there_is_any(dataset_with_depth: Path, locations: Locations, tmp_path: Path) -> None:
    write(dataset_with_depth, tmp_path / "out", locations, SOURCE)
    assert differences(tmp_path / "out") == []
    metadata = json.loads((tmp_path / "out" / "0000" / "metadata.json").read_text())
    assert metadata["labels"] == ["rgb", "depth", "action", "language"]
    with np.load(tmp_path / "out" / "0000" / "depth" / "scene_camera" / "0000000012.npz") as archive:
        assert archive["depth"].dtype == np.uint16
        assert archive["depth"][0, 0] == 712


def test_differences_are_noticed(export: Path, tmp_path: Path) -> None:
    root = shutil.copytree(export, tmp_path / "copy")
    (root / "0002" / "rgb" / "scene_camera" / "x.jpg").write_bytes(b"")
    file = root / "0000" / "lowdim" / "0000000003.pkl"
    changes = {"joints": np.zeros(7, np.float32), "action": np.zeros(26), "magnet": True}
    file.write_bytes(pickle.dumps(pickle.loads(file.read_bytes()) | changes))
    found = "; ".join(differences(root))
    for text in ("x.jpg is too much", "keys are", "(7,), not float32 (14,)", "float64 (26,), not float32 (26,)"):
        assert text in found


def test_frames_hold_what_was_recorded(dataset: Path, export: Path) -> None:
    """A single arm is the left one, its wrist camera too, in its own base; grippers are shares of the opening."""
    for k in (0, 20, frame_count(dataset / "ep_000001") - 1):
        was = load_frame((dataset / "ep_000001" / "lowdim" / f"{k:06d}.pkl").read_bytes())
        frame = pickle.loads((export / "0001" / "lowdim" / f"{k:010d}.pkl").read_bytes())
        for key in ("joints", "action_joints"):
            np.testing.assert_array_equal(frame[key][:6], was[key][:6])
            np.testing.assert_allclose(frame[key][6], was[key][6] / 0.037524, atol=1e-6)
            np.testing.assert_array_equal(frame[key][7:], 0)
        np.testing.assert_array_equal(frame["extrinsics"]["left_wrist_camera"], was["extrinsics"]["right_wrist_camera"])
        np.testing.assert_array_equal(frame["intrinsics"]["scene_camera"], was["intrinsics"]["scene_camera"])
        # Kinematics of the joints give the simulated hand pose.
        np.testing.assert_allclose(frame["actual_poses"][:3], was["ee_pose"][:3, 3], atol=1e-6)
        np.testing.assert_allclose(frame["actual_poses"][3:12].reshape(3, 3), was["ee_pose"][:3, :3], atol=1e-6)
        for key in ("language_task", "language_prompt"):
            # As its converter writes it and as `rd shardify` reads it.
            assert (frame[key].shape, str(frame[key])) == ((), was[key])


CAMERAS = (("scene_camera", "scene_camera"), ("right_wrist_camera", "left_wrist_camera"))


def test_pictures_are_pngs_with_the_pixels_that_opencv_reads_from_the_recorded_jpegs(
    dataset: Path, export: Path
) -> None:
    assert json.loads((export / "0002" / "metadata.json").read_text())["rgb"] == {"extension": "png"}
    for camera, name in CAMERAS:
        folder = export / "0002" / "rgb" / name
        assert not list(folder.glob("*.jpg"))
        frames = frame_count(dataset / "ep_000002")
        for k in range(frames):
            recorded = cv2.imread(str(dataset / "ep_000002" / "rgb" / camera / f"{k:06d}.jpg"))
            np.testing.assert_array_equal(cv2.imread(str(folder / f"{k:010d}.png")), recorded)
        np.testing.assert_array_equal(np.load(folder / "timestamps.npy"), np.arange(frames) * 64_000_000)


def test_jpegs_can_be_kept_byte_for_byte(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    out = write(dataset, tmp_path / "out", locations, RaidenOptions(fps=None, images="jpg"), "2")
    assert differences(out) == []
    assert json.loads((out / "0000" / "metadata.json").read_text())["rgb"] == {"extension": "jpg"}
    for camera, name in CAMERAS:
        for k in (0, frame_count(dataset / "ep_000002") - 1):
            recorded = (dataset / "ep_000002" / "rgb" / camera / f"{k:06d}.jpg").read_bytes()
            assert (out / "0000" / "rgb" / name / f"{k:010d}.jpg").read_bytes() == recorded


@pytest.fixture(scope="module")
def at_30_hz(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(dataset, tmp_path_factory.mktemp("raiden") / "at_30_hz", locations, NEAREST)


@pytest.mark.slow
def test_at_30_hz_the_metadata_has_the_recorded_frame_of_each_picture(dataset: Path, at_30_hz: Path) -> None:
    assert differences(at_30_hz) == []
    metadata = json.loads((at_30_hz / "0001" / "metadata.json").read_text())
    last = (frame_count(dataset / "ep_000001") - 1) * 0.064
    frames = metadata["num_frames"]
    assert metadata["framerate"] == 30
    assert (frames - 1) / 30 <= last < frames / 30
    chosen = metadata["pictures"]["recorded_frames"]
    assert (metadata["pictures"]["source"], metadata["pictures"]["recorded_period_s"]) == ("nearest", 0.064)
    apart = np.abs(np.array(chosen) * 0.064 - np.arange(frames) / 30)
    assert apart.max() < 0.0320001
    assert chosen[48] == 25
    for camera, name in CAMERAS:
        folder = at_30_hz / "0001" / "rgb" / name
        np.testing.assert_array_equal(np.load(folder / "timestamps.npy"), np.round(np.arange(frames) * 1e9 / 30))
        for k, frame in enumerate(chosen):
            recorded = cv2.imread(str(dataset / "ep_000001" / "rgb" / camera / f"{frame:06d}.jpg"))
            np.testing.assert_array_equal(cv2.imread(str(folder / f"{k:010d}.png")), recorded)


def test_at_30_hz_frames_at_recorded_times_are_the_recorded_ones(export: Path, at_30_hz: Path) -> None:
    """Every 1.6 s both rates meet: 48 frames of 1/30 s, 25 of 0.064 s."""
    was, found = frames_of(export / "0001"), frames_of(at_30_hz / "0001")
    for k, recorded in ((0, 0), (48, 25), (96, 50)):
        for key in ("joints", "action_joints", "action", "actual_poses"):
            np.testing.assert_array_equal(found[k][key], was[recorded][key])
        for camera in ("scene_camera", "left_wrist_camera"):
            np.testing.assert_array_equal(found[k]["extrinsics"][camera], was[recorded]["extrinsics"][camera])


def played(frames: list[dict[str, Any]]) -> np.ndarray:
    """Largest joint speeds (6,) of raiden's replay, rad/s: straight lines at 30 frames a second."""
    return np.abs(np.diff(column(frames, "action_joints")[:, :6], axis=0)).max(axis=0) * 30


def test_raidens_replay_keeps_to_the_motors_speeds_at_30_hz_alone(
    dataset: Path, export: Path, at_30_hz: Path, locations: Locations
) -> None:
    """raiden plays all frames at 30 Hz, so those recorded at 15.625 Hz would be 1.92 times too fast."""
    motors = np.array([joint.motor_rad_s for joint in load_config(ArmModel, "robots", "i2rt_yam", locations).joints])
    before = [(played(frames_of(export / f"{k:04d}")) / motors).max() for k in range(EPISODES)]
    after = [(played(frames_of(at_30_hz / f"{k:04d}")) / motors).max() for k in range(EPISODES)]
    # The simulated speed, which raiden's replay must not exceed.
    for k in range(EPISODES):
        record = json.loads((dataset / f"ep_{k:06d}" / "episode.json").read_text())
        assert after[k] <= record["outcome"]["margins"]["velocity_share"] * 1.02 < before[k]


def test_one_arm_alone_has_arrays_of_one_arm(export: Path, dataset: Path, locations: Locations, tmp_path: Path) -> None:
    out = write(dataset, tmp_path / "out", locations, RaidenOptions(fps=None, as_single_arm=True), "1")
    assert differences(out, single=True) == []
    assert any("joints is float32 (7,), not float32 (14,)" in text for text in differences(out))
    assert json.loads((out / "0000" / "metadata.json").read_text())["action"]["dims"] == 7
    both, alone = frames_of(export / "0001"), frames_of(out / "0000")
    for key, width in (("joints", 7), ("action_joints", 7), ("action", 13), ("actual_poses", 13)):
        np.testing.assert_array_equal(column(alone, key), column(both, key)[:, :width])


def test_the_metadata_has_the_control_and_the_hand_frame(
    export: Path, dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    ours = json.loads((export / "0000" / "metadata.json").read_text())
    assert (ours["control"], ours["hand_frame"]["name"]) == ("plan", "yamsim")
    copy = shutil.copytree(dataset, tmp_path / "copy")
    change_record(copy / "ep_000000", source="teleop")
    out = write(copy, tmp_path / "out", locations, RaidenOptions(fps=None, hand_frame="i2rt"), "0")
    theirs = json.loads((out / "0000" / "metadata.json").read_text())
    assert (theirs["control"], theirs["hand_frame"]["name"]) == ("teleop", "i2rt")
    calibration = json.loads((out / "calibration_results.json").read_text())
    assert calibration["hand_frame"] == theirs["hand_frame"]


def test_the_makers_hand_is_some_millimetres_from_ours_and_turned_the_same(
    export: Path, dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    out = write(dataset, tmp_path / "out", locations, RaidenOptions(fps=None, hand_frame="i2rt"), "0")
    assert differences(out) == []
    ours, theirs = frames_of(export / "0000"), frames_of(out / "0000")
    for key in ("action", "actual_poses"):
        apart = np.linalg.norm(column(ours, key)[:, :3] - column(theirs, key)[:, :3], axis=1)
        assert (apart > 0.006).all()
        assert (apart < 0.0095).all()
        np.testing.assert_allclose(column(ours, key)[:, 3:13], column(theirs, key)[:, 3:13], atol=2e-5)
    # Joints do not depend on the kinematics.
    np.testing.assert_array_equal(column(ours, "action_joints"), column(theirs, "action_joints"))
    # A hand-eye pose by other kinematics is only approximate.
    entry = json.loads((out / "calibration_results.json").read_text())["cameras"]["left_wrist_camera"]
    T_cam_in_hand = pose(entry["hand_eye_calibration"]["translation_vector"], entry["extrinsics"]["rotation_matrix"])
    for frame in theirs:
        hand = pose(frame["actual_poses"][:3], frame["actual_poses"][3:12].reshape(3, 3))
        off = (hand @ T_cam_in_hand - frame["extrinsics"]["left_wrist_camera"])[:3, 3]
        assert np.linalg.norm(off) < 0.004


def test_the_labs_fork_reads_the_same_poses(export: Path) -> None:
    """It reads `extrinsics` of either kind of camera, and names their frame."""
    cameras = json.loads((export / "calibration_results.json").read_text())["cameras"]
    assert cameras["scene_camera"]["extrinsics"]["reference_frame"] == "left_arm_base"
    assert cameras["left_wrist_camera"]["extrinsics"]["reference_frame"] == "left_grasp_site"
    assert {entry["arm"] for entry in cameras.values()} == {"left"}
    wrist = cameras["left_wrist_camera"]
    for key in ("rotation_matrix", "translation_vector"):
        assert wrist["extrinsics"][key] == wrist["hand_eye_calibration"][key]


@pytest.mark.slow
def test_an_altered_file_stops_the_export_and_leaves_nothing(
    dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    (copy / "ep_000002" / "rgb" / "scene_camera" / "000050.jpg").write_bytes(b"\xff\xd8\xff\xd9")
    for options in (SOURCE, NEAREST):
        with pytest.raises(DatasetError, match=r"000050\.jpg is not what was recorded"):
            write(copy, tmp_path / "out", locations, options)
        assert [path.name for path in tmp_path.iterdir()] == ["copy"]
    write(copy, tmp_path / "out", locations, SOURCE, "0-1")
    assert differences(tmp_path / "out") == []


def test_an_existing_directory_is_kept_or_moved_aside(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("keep")
    source = open_source(dataset, "0", locations)
    with pytest.raises(UsageError, match="is not empty; move it aside with --overwrite"):
        export_raiden(source, out, locations, lambda *_: None, SOURCE)
    done = export_raiden(source, out, locations, lambda *_: None, SOURCE, overwrite=True)
    assert done.moved_aside is not None
    assert (done.moved_aside / "mine").read_text() == "keep"
    assert differences(out) == []
    with pytest.raises(UsageError, match="there is no directory"):
        export_raiden(source, tmp_path / "no" / "where", locations, lambda *_: None, SOURCE)


@pytest.mark.parametrize(
    ("function", "options"),
    [("core.files.writing._fsync_file", SOURCE), ("export.raiden_episode._write_with_parents", NEAREST)],
    ids=["end", "pictures"],
)
def test_a_full_disk_is_reported_and_leaves_nothing(
    function: str,
    options: RaidenOptions,
    dataset: Path,
    locations: Locations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(path: Path, *data: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(f"yamsim_cli.{function}", full)
    with pytest.raises(PartialJobError, match="nothing was exported"):
        write(dataset, tmp_path / "out", locations, options, "0")
    assert list(tmp_path.iterdir()) == []


def test_overlay_reads_the_cameras_of_the_calibration_file(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    dataset = tmp_path / "dataset"
    write_dataset(dataset, make_config({("wrist",): True, ("image", "size_px"): list(SIZE)}), locations, 1, jpeg)
    file = write(dataset, tmp_path / "out", locations, SOURCE) / "calibration_results.json"
    frame = load_frame((dataset / "ep_000000/lowdim/000000.pkl").read_bytes())
    for camera, name in CAMERAS:
        model = load_config(CameraConfig, "cameras", f"{file}:{name}", locations).camera_model
        assert (model.width, model.height) == SIZE
        np.testing.assert_allclose(model.K, frame["intrinsics"][camera], rtol=1e-6)
