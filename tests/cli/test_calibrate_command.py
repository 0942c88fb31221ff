"""`yamsim calibrate` as a user runs it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from tests.cli.run_cli import yamsim
from tests.real.recordings.foreign import write_lowdim
from tests.real.recordings.making import swinging, write_csv
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.files.resources import Locations

RIG = "yam_v1+linear_4310"


def test_wrong_input_is_refused_with_its_reason(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    write_csv(tmp_path / "log.csv", swinging(single, 0.5), single)
    run = yamsim("calibrate", "log.csv", "--rig", "single", cwd=tmp_path)
    assert (run.code, "no episode has pictures" in run.message) == (2, True)
    both = yamsim("calibrate", "log.csv", "--rig", "single", "--near", "a.yaml", "--check", "b.yaml", cwd=tmp_path)
    assert (both.code, "exclude each other" in both.message) == (2, True)
    missing = yamsim("calibrate", "log.csv", "--rig", "single", "--near", "a.yaml", cwd=tmp_path)
    assert (missing.code, "a.yaml" in missing.message) == (3, True)


CALIBRATION = """
rig: single
reference: arm1
cameras:
- {name: scene_camera, position: [0.4, 0.0, 1.2], quat: [0.0, 1.0, 0.0, 0.0], width: 32, height: 24, focal: given,
   K: [[30.0, 0.0, 15.5], [0.0, 30.0, 11.5], [0.0, 0.0, 1.0]], position_95_mm: [2, 2, 2],
   rotation_95_deg: [0.1, 0.1, 0.1],
   focal_95_percent: 0.5, delay_ms: 20.0, delay_95_ms: 5.0, frames: 40, outline_px: 0.2}
arms:
- {name: arm1, position: [0.0, 0.0, 0.0], quat: [1.0, 0.0, 0.0, 0.0], position_95_mm: [0, 0, 0],
   rotation_95_deg: [0, 0, 0], joint_offsets_deg: [0, 1, 0, 0, 0, 0],
   joint_offsets_95_deg: [0, 0.2, 0.2, 0.2, 0.2, 0.2],
   joint_offsets_estimated: [false, true, true, true, true, true]}
"""


def test_overlay_and_import_use_a_calibration(single: RigConfig, tmp_path: Path) -> None:
    write_lowdim(tmp_path / "one", swinging(single, 0.1), single)
    (tmp_path / "calibration.yaml").write_text(CALIBRATION.replace("arm1", single.arms[0].name))
    run = yamsim("import", "one", "--rig", "single", "--calibration", "calibration.yaml", cwd=tmp_path)
    assert run.code == 0, run.err
    frame = load_frame((tmp_path / "real/ep_000000/lowdim/000000.pkl").read_bytes())
    assert np.asarray(frame["extrinsics"]["scene_camera"])[:3, 3] == pytest.approx([0.4, 0.0, 1.2])
    shown = ("overlay", "--episode", "real/ep_000000", "--every", "5", "--json")
    drawn = yamsim(*shown, "--calibration", "calibration.yaml", cwd=tmp_path)
    assert drawn.code == 0, drawn.err
    assert [image["arms"][0]["status"] for image in drawn.json["images"]] == ["calibrated", "calibrated"]
    wrong = yamsim(*shown, "--calibration", "calibration.yaml:top", "--out", "o", cwd=tmp_path)
    assert (wrong.code, "no camera 'top'" in wrong.message) == (2, True)
    other = yamsim("import", "one", "--rig", RIG, "--calibration", "calibration.yaml", "--out", "o", cwd=tmp_path)
    assert (other.code, "of rig 'single'" in other.message) == (2, True)


def test_unusable_pictures_are_refused_with_a_remedy(single: RigConfig, tmp_path: Path) -> None:
    motion = swinging(single, 2.0)
    write_lowdim(tmp_path / "no_arm", motion, single)
    for file in (tmp_path / "no_arm/rgb/scene_camera").iterdir():
        cv2.imwrite(str(file), np.full((24, 32, 3), 120, np.uint8))
    unseen = yamsim("calibrate", "no_arm", "--rig", "single", "--frames", "16", cwd=tmp_path)
    assert (unseen.code, "0.0% of the picture changes when the arms move" in unseen.message) == (4, True)
    write_lowdim(tmp_path / "ten", swinging(single, 0.1), single)
    few = yamsim("calibrate", "ten", "--rig", "single", "--out", "few", cwd=tmp_path)
    assert (few.code, "pictures show different poses" in few.message, "at least 16" in few.message) == (
        4,
        True,
        True,
    )
    arms = tuple(replace(arm, joints=np.degrees(arm.joints)) for arm in motion.arms)
    write_lowdim(tmp_path / "degrees", replace(motion, arms=arms), single)
    wrong = yamsim("calibrate", "degrees", "--rig", "single", "--out", "d", cwd=tmp_path)
    assert (wrong.code, "degrees" in wrong.message) == (4, True)


def test_a_left_arm_that_never_moves_is_told(station: RigConfig, tmp_path: Path) -> None:
    motion = swinging(station, 2.0)
    left, right = motion.arms
    still = replace(left, joints=left.joints[:1].repeat(len(left.joints), axis=0))
    messages = []
    for name, arms in (("still", (still, right)), ("moving", (left, right))):
        write_lowdim(tmp_path / name, replace(motion, arms=arms), station)
        run = yamsim("calibrate", name, "--rig", station.name, "--frames", "16", "--out", f"of_{name}", cwd=tmp_path)
        assert run.code == 4
        messages.append(run.message)
    arm = station.arms[station.recording_order[0]].name
    assert f"no joint of the left arm ({arm}), in whose base poses are given, moves by 5 degrees" in messages[0]
    assert "no joint of the left arm" not in messages[1]


@pytest.mark.long
@pytest.mark.slow
def test_a_recorded_camera_is_found_and_checked(tmp_path: Path) -> None:
    record = ("record", "--task", "pickplace", "--rig", RIG, "--n", "4", "--size", "320x240", "--seed", "5", "--wrist")
    assert yamsim(*record, "--quality", "balanced", "--out", "data", cwd=tmp_path).code == 0
    limits = ("--frames", "30", "--max-shift", "30", "--max-turn", "2")
    run = yamsim("calibrate", "data", "--rig", RIG, *limits, "--json", cwd=tmp_path)
    assert run.code == 0, run.err
    camera = run.json["calibration"]["cameras"][0]
    frame = load_frame((tmp_path / "data" / "ep_000000" / "lowdim").glob("*.pkl").__next__().read_bytes())
    error = np.array(camera["position"]) - np.asarray(frame["extrinsics"]["scene_camera"])[:3, 3]
    assert np.linalg.norm(error) < 0.01
    assert (tmp_path / "calibration" / "calibration.html").is_file()
    assert json.loads((tmp_path / "calibration" / "calibration.json").read_text()) == run.json
    wrist = ("--camera", "right_wrist_camera", "--camera", "scene_camera")
    both = yamsim("calibrate", "data", "--rig", RIG, *limits, *wrist, "--out", "both", "--json", cwd=tmp_path)
    assert both.code == 0, both.err
    (on_flange,) = both.json["calibration"]["wrist_cameras"]
    assert (on_flange["arm"], both.json["wrist_cameras"][0]["status"]) == ("arm1", "ok")
    file = tmp_path / "calibration" / "calibration.yaml"
    moved = yaml.safe_load(file.read_text())
    moved["cameras"][0]["position"][1] += 0.08
    (tmp_path / "moved.yaml").write_text(yaml.safe_dump(moved))
    check = yamsim("calibrate", "data", "--rig", RIG, *limits, "--check", "moved.yaml", "--out", "c", cwd=tmp_path)
    assert (check.code, "contradict the calibration" in check.err) == (5, True)
