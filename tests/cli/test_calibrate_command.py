"""`yamsim calibrate` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.cli.run_cli import yamsim
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


@pytest.mark.slow
def test_a_recorded_camera_is_found_and_checked(tmp_path: Path) -> None:
    record = ("record", "--task", "pickplace", "--rig", RIG, "--n", "4", "--size", "320x240", "--seed", "5")
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
    file = tmp_path / "calibration" / "calibration.yaml"
    moved = yaml.safe_load(file.read_text())
    moved["cameras"][0]["position"][1] += 0.08
    (tmp_path / "moved.yaml").write_text(yaml.safe_dump(moved))
    check = yamsim("calibrate", "data", "--rig", RIG, *limits, "--check", "moved.yaml", "--out", "c", cwd=tmp_path)
    assert (check.code, "contradict the calibration" in check.err) == (5, True)
