"""The file of a calibration, its check, and the choice of pictures and backgrounds."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.calibration.handmade_station import handmade_station
from yamsim_cli.calibration.calibrate_run import CameraOutcome, StationOutcome
from yamsim_cli.calibration.calibration_file import (
    CalibratedArm,
    CalibratedCamera,
    Calibration,
    calibration_text,
    load_calibration,
)
from yamsim_cli.calibration.calibration_report import make_calibration, require_agreement, write_page, write_results
from yamsim_cli.calibration.camera_start import CameraStart
from yamsim_cli.calibration.chosen_frames import (
    BackgroundPicture,
    compare_with_background,
    median_background,
    spread_choice,
    uncovered_background,
)
from yamsim_cli.calibration.pose_search import MaskView, mask_overlap
from yamsim_cli.calibration.station_fit import Layout, StationFit, start_state
from yamsim_cli.calibration.uncertainty import PoseInterval, StationIntervals, is_base_measured
from yamsim_cli.calibration.wrist_fit import WristFit, WristOutcome
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError, SimulationError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_vector, rotation_z


def _calibration(x: float) -> Calibration:
    camera = CalibratedCamera(
        name="top",
        position=(x, 0.0, 1.0),
        quat=(0.0, 1.0, 0.0, 0.0),
        width=320,
        height=240,
        K=((300.0, 0.0, 159.5), (0.0, 300.0, 119.5), (0.0, 0.0, 1.0)),
        focal="given",
        position_95_mm=(2.0, 2.0, 2.0),
        rotation_95_deg=(0.2, 0.2, 0.2),
        focal_95_percent=0.3,
        delay_ms=10.0,
        delay_95_ms=5.0,
        frames=40,
        outline_px=0.2,
    )
    arm = CalibratedArm(
        name="arm1",
        position=(0.0, 0.0, 0.0),
        quat=(1.0, 0.0, 0.0, 0.0),
        position_95_mm=(0.0, 0.0, 0.0),
        rotation_95_deg=(0.0, 0.0, 0.0),
        joint_offsets_deg=(0.0, 1.0),
        joint_offsets_95_deg=(0.0, 0.3),
        joint_offsets_estimated=(False, True),
    )
    return Calibration(rig="single", reference="arm1", cameras=(camera,), arms=(arm,))


def test_a_calibration_is_read_as_written(locations: Locations, tmp_path: Path) -> None:
    file = tmp_path / "calibration.yaml"
    file.write_text(calibration_text(_calibration(0.3)))
    assert load_calibration(file, locations) == _calibration(0.3)
    assert load_calibration(file.parent, locations) == _calibration(0.3)
    file.write_text("rig: single\n")
    with pytest.raises(ConfigError, match=r"calibration\.yaml"):
        load_calibration(file, locations)


def test_a_calibration_places_the_camera_and_the_arms_of_its_rig(locations: Locations) -> None:
    calibration = _calibration(0.3)
    placed = calibration.placed_camera(calibration.camera(None, "--calibrated-camera"))
    np.testing.assert_allclose(placed.T_bases_in_cam[0] @ [0.3, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(placed.offsets[0]), [0.0, 1.0])
    assert (placed.delay, placed.camera.K) == (0.01, calibration.cameras[0].K)
    single, russet = (load_config(RigConfig, "rigs", name, locations) for name in ("single", "russet"))
    with pytest.raises(UsageError, match="--calibration: the calibration is of rig 'single', not 'russet'"):
        calibration.for_rig(russet, "--calibration")
    (arm,) = single.arms
    other = single.model_copy(update={"arms": (arm.model_copy(update={"name": "other"}),)})
    with pytest.raises(UsageError, match="has the arms arm1; rig 'single' has other"):
        calibration.for_rig(other, "--calibration")
    several = calibration.model_copy(update={"cameras": calibration.cameras * 2})
    with pytest.raises(UsageError, match=r"several cameras \(top, top\); name one: --calibrated-camera"):
        several.camera(None, "--calibrated-camera")


def test_a_check_fails_beyond_both_intervals() -> None:
    assert require_agreement(_calibration(0.3), _calibration(0.3035))[0]["agrees"]
    with pytest.raises(SimulationError, match=r"'top' is 4\.5 mm"):
        require_agreement(_calibration(0.3), _calibration(0.3045))


def test_chosen_poses_are_far_from_each_other() -> None:
    poses = np.array([[0.0], [0.01], [0.02], [1.0], [1.01], [2.0]])
    chosen = poses[spread_choice(poses, 3)].ravel()
    assert np.diff(chosen).min() > 0.9


def test_a_background_is_what_the_arm_does_not_cover() -> None:
    wall, arm = np.full((20, 30, 3), 90, np.uint8), np.full((20, 30, 3), 250, np.uint8)
    covered = np.zeros((20, 30), bool)
    covered[:, :10] = True
    # The arm covers the left part in most pictures.
    images = [np.where(covered[..., None], arm, wall)] * 5 + [wall] * 3
    pictures = [BackgroundPicture(0, float(k), image) for k, image in enumerate(images)]
    assert median_background(pictures).image[0, 0, 0] == 250
    clean = uncovered_background(pictures, [covered] * 5 + [~covered & False] * 3)
    assert (clean.image == 90).all() and clean.known.all()
    unseen = uncovered_background(pictures, [covered] * 8)
    assert not unseen.known[:, :10].any() and unseen.known[:, 10:].all()
    frame = compare_with_background((0, 0, 0.0), images[0], 0, clean)
    assert frame.changed[5:15, 2:8].all() and not frame.changed[5:15, 14:].any()


def test_the_overlap_is_largest_at_the_true_pose() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (3000, 3)) * [0.25, 0.05, 0.05]
    K = np.array([[200.0, 0.0, 79.5], [0.0, 200.0, 59.5], [0.0, 0.0, 1.0]])
    truth = pose((0.02, 0.01, 1.0))
    in_cam = points + truth[:3, 3]
    pixels = np.round(in_cam[:, :2] / in_cam[:, 2:] * 200 + [79.5, 59.5]).astype(int)
    changed = np.zeros((120, 160), bool)
    changed[pixels[:, 1], pixels[:, 0]] = True
    views = [MaskView(changed, points)]
    best = mask_overlap(views, K, truth)
    assert best > 0.7
    assert max(mask_overlap(views, K, truth + pose(shift) - np.eye(4)) for shift in ((0.05, 0, 0), (0, 0.05, 0))) < best


def test_a_refusal_leaves_no_calibration_of_an_earlier_run(tmp_path: Path) -> None:
    written = write_results(tmp_path, {"rig": "single"}, "page", _calibration(0.0))
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert "position" in (tmp_path / "calibration.yaml").read_text()
    again = write_results(tmp_path, {"rig": "single"}, "page", None)
    assert sorted(tmp_path.iterdir()) == sorted(again)
    assert [file.name for file in again] == ["calibration.json", "calibration.html"]


MODEL = CameraModel.from_focal_length(320, 240, 300.0, focal_sigma=0.003)
EXACT = PoseInterval(np.zeros(3), np.zeros(3))


def _outcome(rig: RigConfig, log_focal: float, is_focal_known: bool) -> StationOutcome:
    """A fit of one camera of a rig with one arm."""
    state = start_state(rig, [np.eye(4)], [log_focal], 1)
    layout = Layout(1, 1, (rig.arms[0].robot.dof,), 0)
    equations: Any = SimpleNamespace(camera=0, median=0.2)
    fit = StationFit(layout, state, (equations,), np.eye(layout.size), (np.zeros(3),))
    intervals = StationIntervals(
        (EXACT,), (0.02,), (0.0,), (0.0,), (np.zeros(layout.dofs[0]),), (EXACT,), (0.0,), (0.0,)
    )
    camera = CameraOutcome("top", CameraStart(MODEL, is_focal_known, True), None, {"frames": 40})
    return StationOutcome((camera,), ("top",), (), (), fit, intervals)


@pytest.mark.parametrize(("focal", "half_width"), [("given", 100 * math.log(1.01)), ("estimated", 2.0)])
def test_the_pose_and_the_focal_length_are_of_one_fit(single: RigConfig, focal: str, half_width: float) -> None:
    calibration = make_calibration(single, _outcome(single, math.log(1.01), focal == "given"))
    assert calibration is not None
    found = calibration.cameras[0]
    assert (found.K[0][0], found.K[1][1], found.K[0][2]) == pytest.approx((303.0, 303.0, MODEL.K[0][2]))
    assert (found.focal, found.focal_95_percent) == (focal, pytest.approx(half_width, rel=1e-3))


def test_the_pose_of_a_wrist_camera_and_its_focal_length_are_of_one_fit(single: RigConfig) -> None:
    model = CameraStart(MODEL, True, False).fitted_model(0.03, math.log(0.99))
    wrist = WristOutcome("wrist", WristFit("wrist", 0, np.eye(4), model, 0.0123456789, EXACT, 30, 1, 0.9, 0.2), None)
    calibration = make_calibration(single, _outcome(single, 0.0, True), [wrist])
    assert calibration is not None
    found = calibration.wrist_cameras[0]
    assert (found.K[0][0], found.K[1][1], found.K[0][2]) == pytest.approx((297.0, 297.0, MODEL.K[0][2]))
    assert (found.distortion, found.k1_95) == ((0.03, 0.0, 0.0, 0.0), 0.012346)
    assert CameraStart(MODEL, True, True).fitted_model(0.03, 0.0) == MODEL


def test_a_wrist_camera_is_written_if_all_fixed_cameras_are_refused(station: RigConfig, tmp_path: Path) -> None:
    refused = CameraOutcome("top", CameraStart(MODEL, True, True), "it sees no arm")
    outcome = StationOutcome((refused,), (), (), (), None, None)
    fit = WristFit("wrist", 0, np.eye(4), MODEL, None, EXACT, 30, 1, 0.9, 0.2)
    found = make_calibration(station, outcome, [WristOutcome("wrist", fit, None)])
    assert found is not None
    assert (found.cameras, [one.name for one in found.wrist_cameras]) == ((), ["wrist"])
    with pytest.raises(UsageError, match="only wrist cameras"):
        found.camera(None, "--episode-camera")
    assert not any(estimated for arm in found.arms for estimated in arm.joint_offsets_estimated)
    widths = {arm.name == found.reference: (arm.position_95_mm, arm.rotation_95_deg) for arm in found.arms}
    assert widths[True] == ((0, 0, 0), (0, 0, 0))
    assert not is_base_measured(*widths[False])
    assert make_calibration(station, outcome, [WristOutcome("wrist", fit, "uncertain")]) is None


def test_the_turn_of_the_base_body_leaves_the_links_in_place(station: RigConfig, tmp_path: Path) -> None:
    handmade_station(tmp_path, station).write()
    calibration = load_calibration(tmp_path, Locations.from_environment({}))
    old = calibration.arms[0]
    assert old.base_body_turn_95_deg is None  # a file of an older version
    arm = old.model_copy(update={"base_body_turn_deg": 1.2})
    measured = 0.3

    def link(T_base: Array, offsets: Array) -> Array:
        return T_base @ pose(rotation=rotation_z(measured - float(offsets[0])))

    turned = link(arm.T_base_body_in_reference, arm.base_body_offsets)
    np.testing.assert_allclose(turned, link(arm.T_base_in_reference, arm.offsets), atol=1e-12)
    turn = rotation_vector(arm.T_base_in_reference[:3, :3].T @ arm.T_base_body_in_reference[:3, :3])
    np.testing.assert_allclose(np.degrees(turn), [0, 0, 1.2], atol=1e-9)
    np.testing.assert_allclose(arm.base_body_offsets[1:], arm.offsets[1:])


def test_the_page_has_wrist_cameras_offsets_by_joint_and_refusals(
    station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    handmade_station(tmp_path, station).write()
    calibration = load_calibration(tmp_path, locations)
    turned = {"base_body_turn_deg": 1.2, "base_body_turn_95_deg": 0.3}
    arms = tuple(arm.model_copy(update=turned) for arm in calibration.arms)
    calibration = calibration.model_copy(update={"arms": arms})
    refused = CameraOutcome("back", CameraStart(MODEL, True, True), "it sees no arm")
    wrist = WristOutcome("left_wrist", None, "too few pictures")
    page = write_page(station, StationOutcome((refused,), (), (), (), None, None), calibration, [wrist])
    (tmp_path / "page.html").write_text(page)
    text = re.sub(r"\s+", " ", re.sub("<[^>]+>", " ", page)).replace("\N{NO-BREAK SPACE}", " ")
    for part in (
        "back: it sees no arm",
        "left_wrist: too few pictures",
        "left_eye",
        "400.0 \N{PLUS-MINUS SIGN} 2.0, 100.0",
        "joint 6",
        "the reference 1.20 \N{PLUS-MINUS SIGN} 0.30 \N{EM DASH}",
    ):
        assert part in text, part
