"""Exports of two arms: each arm's numbers at their place, against the simulation's poses."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export.lerobot_files import check_numbers, rows
from tests.export.lerobot_files import recorded as all_recorded
from tests.export.raiden_diff import column, differences, frames_of
from tests.unrendered import change_record
from yamsim_cli.calibration.calibration_file import Calibration
from yamsim_cli.calibration.export_formats.formats import make_files
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import parse_config
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import read_recording_config
from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, quat_from_rotation
from yamsim_cli.core.scene.cameras import wrist_camera_pose
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.lerobot import export_lerobot
from yamsim_cli.export.raiden import export_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialRunner

CAMERAS = ("scene_camera", "left_wrist_camera", "right_wrist_camera")
SIDES = ("left", "right")
DRIVES = [f"{side}_{name}" for side in SIDES for name in (*(f"joint{k}" for k in range(1, 7)), "gripper")]


def recorded(dataset: Path) -> list[dict[str, Any]]:
    return all_recorded(dataset)[0]


@pytest.fixture(scope="module")
def raiden(two_armed: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("raiden") / "out"
    source = open_source(two_armed, None, locations)
    export_raiden(source, out, locations, lambda *_: None, RaidenOptions(fps=None))
    return out


@pytest.fixture(scope="module")
def lerobot(two_armed: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    for module in ("av", "pyarrow"):
        pytest.importorskip(module, reason="yamsim[lerobot] is not installed")
    out = tmp_path_factory.mktemp("lerobot") / "out"
    export_lerobot(open_source(two_armed, None, locations), out, lambda *_: None)
    return out


def exported(root: Path) -> list[dict[str, Any]]:
    return frames_of(root / "0000")


def hands(poses: np.ndarray, number: int) -> list[Array]:
    """One arm's hand (4, 4) in its own base, of `action` or `actual_poses`."""
    parts = poses[:, 13 * number : 13 * number + 12]
    return [pose(part[:3], part[3:].reshape(3, 3)) for part in parts]


def test_raidens_schema_holds_for_two_arms(raiden: Path) -> None:
    assert differences(raiden, arms=2) == []
    assert any("too much" in text for text in differences(raiden, arms=1))


def test_raidens_joints_and_commands_are_the_left_arms_first(two_armed: Path, raiden: Path) -> None:
    was, found = recorded(two_armed), exported(raiden)
    assert len(found) == len(was)
    shares = np.ones(14)
    shares[[6, 13]] = 1 / 0.037524
    for key in ("joints", "action_joints"):
        wanted = column(was, key) * shares
        wanted[:, [6, 13]] = wanted[:, [6, 13]].clip(0, 1)
        np.testing.assert_allclose(column(found, key), wanted, atol=1e-6)
    # So that a swap would show.
    assert np.abs(column(was, "joints")[:, :7] - column(was, "joints")[:, 7:]).max() > 0.5


def test_raidens_hands_are_where_the_simulation_had_them_each_in_its_own_base(two_armed: Path, raiden: Path) -> None:
    was, found = recorded(two_armed), exported(raiden)
    bases = (np.eye(4), was[0]["T_right_base_in_left_base"])
    joints = column(found, "joints")
    for number, base in enumerate(bases):
        actual = hands(column(found, "actual_poses"), number)
        np.testing.assert_allclose(base @ actual, column(was, "ee_pose")[:, number], atol=1e-6)
        np.testing.assert_array_equal(column(found, "actual_poses")[:, 13 * number + 12], joints[:, 7 * number + 6])
        # A command's target time is the end of a frame's first control tick.
        commanded = np.array(hands(column(found, "action"), number))[:-1, :3, 3]
        here = np.array(actual)[:, :3, 3]
        halfway = (here[:-1] + here[1:]) / 2
        assert np.linalg.norm(commanded - halfway, axis=1).max() < 0.02
        gripper = column(found, "action_joints")[:, 7 * number + 6]
        np.testing.assert_array_equal(column(found, "action")[:, 13 * number + 12], gripper)
    # As raiden's visualizer uses it.
    np.testing.assert_array_equal(column(found, "T_left_from_right"), column(was, "T_right_base_in_left_base"))


def test_raidens_cameras_are_in_the_left_base_and_its_calibration_says_so_too(two_armed: Path, raiden: Path) -> None:
    """As raiden itself computes it: transform between bases, kinematics, hand-eye pose."""
    was, found = recorded(two_armed), exported(raiden)
    calibration = json.loads((raiden / "calibration_results.json").read_text())
    between = calibration["bimanual_transform"]
    # Its converter inverts the value of this name.
    T_right_in_left = invert_pose(np.array(between["right_base_to_left_base"]))
    np.testing.assert_allclose(T_right_in_left[:3, 3], (0, -0.591, 0), atol=1e-6)
    np.testing.assert_allclose(between["T_right_base_in_left_base"], T_right_in_left, atol=1e-9)
    for number, (side, base) in enumerate(zip(SIDES, (np.eye(4), T_right_in_left), strict=True)):
        name = f"{side}_wrist_camera"
        entry = calibration["cameras"][name]["hand_eye_calibration"]
        T_cam_in_hand = pose(entry["translation_vector"], entry["rotation_matrix"])
        # Its converter rotates the right camera, which is mounted upside down on a real arm.
        assert entry["upside_down"] is (side == "right")
        if side == "right":
            T_cam_in_hand = T_cam_in_hand @ np.diag([-1.0, -1.0, 1.0, 1.0])
        # The lab's fork does not rotate it.
        other = calibration["cameras"][name]["extrinsics"]
        assert other["reference_frame"] == f"{side}_grasp_site"
        np.testing.assert_allclose(
            pose(other["translation_vector"], other["rotation_matrix"]), T_cam_in_hand, atol=1e-9
        )
        chain = [base @ hand @ T_cam_in_hand for hand in hands(column(found, "actual_poses"), number)]
        np.testing.assert_allclose(chain, [frame["extrinsics"][name] for frame in found], atol=2e-6)
        np.testing.assert_allclose(chain, [frame["extrinsics"][name] for frame in was], atol=2e-6)
    scene = calibration["cameras"]["scene_camera"]["extrinsics"]
    T = pose(scene["translation_vector"], scene["rotation_matrix"])
    np.testing.assert_allclose(T, was[0]["extrinsics"]["scene_camera"], atol=1e-6)


def test_a_calibration_with_the_true_poses_becomes_the_same_raiden_file(
    two_armed: Path, raiden: Path, locations: Locations
) -> None:
    true = json.loads((raiden / "calibration_results.json").read_text())
    frame, rig = recorded(two_armed)[0], read_recording_config(two_armed, locations).rig

    def keys(camera: str | None, T: Any) -> dict[str, Any]:
        found = {"position": T[:3, 3].tolist(), "quat": quat_from_rotation(T[:3, :3]).tolist()}
        found |= {"position_95_mm": [1.0] * 3, "rotation_95_deg": [0.1] * 3}
        if camera is None:
            return found
        width, height = true["cameras"][camera]["intrinsics"]["image_size"]
        lens = {"K": frame["intrinsics"][camera].tolist(), "width": width, "height": height}
        return found | lens | {"name": camera, "outline_px": 0.1}

    figures = {"focal": "given", "focal_95_percent": 0.5, "delay_ms": 0.0, "delay_95_ms": 5.0, "frames": 40}
    offsets = {"joint_offsets_deg": [0.0] * 6, "joint_offsets_95_deg": [1.0] * 6}
    left = rig.arms[rig.recording_order[0]]
    bases = [np.eye(4) if arm is left else np.asarray(frame["T_right_base_in_left_base"]) for arm in rig.arms]
    data = {
        "rig": rig.name,
        "reference": left.name,
        "cameras": [keys("scene_camera", np.asarray(frame["extrinsics"]["scene_camera"])) | figures],
        "arms": [
            keys(None, T) | {"name": arm.name, **offsets, "joint_offsets_estimated": [False] * 6}
            for arm, T in zip(rig.arms, bases, strict=True)
        ],
        "wrist_cameras": [
            keys(arm.wrist_camera_name, wrist_camera_pose(arm)) | {"arm": arm.name, "pictures": 12} for arm in rig.arms
        ],
    }
    calibration = parse_config(Calibration, json.dumps(data), "calibration.yaml", locations)
    made = make_files(calibration, rig, locations, ["raiden"])["raiden"]
    assert made.left_out == ()
    found = json.loads(made.files["calibration_results.json"])
    assert found.keys() == true.keys()
    assert found["cameras"].keys() == true["cameras"].keys()
    base, other = found["bimanual_transform"], true["bimanual_transform"]
    np.testing.assert_allclose(base["right_base_to_left_base"], other["right_base_to_left_base"], atol=1e-6)
    for camera in CAMERAS:
        one, other = found["cameras"][camera], true["cameras"][camera]
        assert one.keys() == other.keys()
        np.testing.assert_allclose(one["intrinsics"]["camera_matrix"], other["intrinsics"]["camera_matrix"], atol=1e-4)
        for part in {"extrinsics", "hand_eye_calibration"} & one.keys():
            assert one[part].keys() == other[part].keys()
            for key in ("rotation_matrix", "translation_vector"):
                np.testing.assert_allclose(
                    one[part][key], other[part][key], atol=2e-6, err_msg=f"{camera} {part} {key}"
                )


def test_two_arms_do_not_go_into_the_arrays_of_one(two_armed: Path, locations: Locations, tmp_path: Path) -> None:
    source = open_source(two_armed, None, locations)
    with pytest.raises(UsageError, match=r"--single is for recordings of one arm, and .* has 2"):
        export_raiden(source, tmp_path / "out", locations, lambda *_: None, RaidenOptions(fps=None, as_single_arm=True))
    assert not (tmp_path / "out").exists()


def test_two_arms_at_30_hz(two_armed: Path, raiden: Path, locations: Locations, tmp_path: Path) -> None:
    source = open_source(two_armed, None, locations)
    export_raiden(source, tmp_path / "out", locations, lambda *_: None, RaidenOptions(pictures="nearest"))
    assert differences(tmp_path / "out", arms=2) == []
    was, found = exported(raiden), exported(tmp_path / "out")
    assert (len(found) - 1) / 30 <= (len(was) - 1) * 0.064 < len(found) / 30
    for k, frame in ((0, 0), (48, 25), (96, 50), (144, 75)):
        for key in ("joints", "action", "actual_poses", "action_joints", "T_left_from_right"):
            np.testing.assert_array_equal(found[k][key], was[frame][key])


def test_lerobots_numbers_are_the_recorded_ones(two_armed: Path, lerobot: Path) -> None:
    check_numbers(rows(lerobot, "data/*/*.parquet"), [recorded(two_armed)], CAMERAS)


def test_lerobots_parts_are_named_after_their_arms(two_armed: Path, lerobot: Path) -> None:
    info = json.loads((lerobot / "meta" / "info.json").read_text())
    assert info["robot_type"] == "bi_i2rt_yam"
    assert info["features"]["observation.state"] == {"dtype": "float32", "shape": [14], "names": DRIVES}
    names = [*DRIVES, "left_magnet", "right_magnet"]
    assert info["features"]["action"] == {"dtype": "float32", "shape": [16], "names": names}
    assert {key for key in info["features"] if "images" in key} == {f"observation.images.{name}" for name in CAMERAS}
    stats = json.loads((lerobot / "meta" / "stats.json").read_text())
    assert (len(stats["observation.state"]["mean"]), len(stats["action"]["q99"])) == (14, 16)
    provenance = json.loads((lerobot / "meta" / "yamsim.json").read_text())
    wanted = recorded(two_armed)[0]["T_right_base_in_left_base"]
    np.testing.assert_array_equal(np.array(provenance["T_right_base_in_left_base"], np.float32), wanted)


PLAYER = """
import numpy as np


class Player:
    images = ()
    ticks = 2

    def __init__(self):
        self._actions = np.load({file!r})

    def reset(self):
        self._frame = 0

    def __call__(self, observation):
        action, self._frame = self._actions[self._frame], self._frame + 1
        return {{"ctrl": action[:14], "magnet": action[14:] > 0.5, "done": self._frame == len(self._actions)}}
"""


def test_lerobots_actions_are_those_that_a_policy_answers_with(
    two_armed: Path, lerobot: Path, locations: Locations, tmp_path: Path
) -> None:
    np.save(tmp_path / "actions.npy", rows(lerobot, "data/*/*.parquet")["action"])
    (tmp_path / "player.py").write_text(PLAYER.format(file=str(tmp_path / "actions.npy")))
    config = read_recording_config(two_armed, locations)
    with TrialRunner(Session(config, locations), PolicyChoice("player.py:Player", tmp_path)) as runner:
        outcome = runner.run(AttemptJob(config.seed, 0)).outcome
    assert outcome.success, outcome.detail


def test_rerun_shows_both_arms_in_the_left_base(two_armed: Path, locations: Locations, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="yamsim[rerun] is not installed")
    chunks = pytest.importorskip("rerun.chunk", reason="this rerun cannot read its files")
    from yamsim_cli.export.rrd import export_rerun

    done = export_rerun(open_source(two_armed, None, locations), tmp_path / "out", lambda *_: None)
    logged: dict[tuple[str, str], list[Any]] = {}
    for chunk in chunks.RrdReader(done.path / "ep_000000.rrd").stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if ":" in name:
                logged.setdefault((chunk.entity_path, name), []).extend(batch.column(name).to_pylist())

    def values(entity: str, component: str) -> np.ndarray:
        return np.array(logged[entity, component], float).squeeze()

    frames = recorded(two_armed)
    for key in ("joints", "ctrl"):
        for number, name in enumerate(DRIVES):
            found = values(f"/{key}/{name}", "Scalars:scalars")
            np.testing.assert_array_equal(found, column(frames, key)[:, number], err_msg=f"{key}/{name}")
    for number, side in enumerate(SIDES):
        np.testing.assert_array_equal(values(f"/{side}_weld", "Scalars:scalars"), column(frames, "magnet")[:, number])
        where = column(frames, "ee_pose")[:, number, :3, 3]
        np.testing.assert_array_equal(values(f"/base/{side}_hand", "Transform3D:translation"), where)
        camera = f"{side}_wrist_camera"
        looks_from = [frame["extrinsics"][camera][:3, 3] for frame in frames]
        np.testing.assert_array_equal(values(f"/base/{camera}", "Transform3D:translation"), looks_from)
    np.testing.assert_allclose(values("/base/right_base", "Transform3D:translation"), (0, -0.591, 0), atol=1e-6)


def test_episodes_of_one_arm_and_of_two_do_not_mix(two_armed: Path, locations: Locations, tmp_path: Path) -> None:
    copy = shutil.copytree(two_armed, tmp_path / "copy")
    shutil.copytree(copy / "ep_000000", copy / "ep_000001")
    change_record(copy / "ep_000001", arms=1)
    source = open_source(copy, None, locations)
    with pytest.raises(DatasetError, match=r"has other arms than ep_000000 \(1, not 2\)"):
        list(source.open_episodes())
