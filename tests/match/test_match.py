"""`yamsim match` on photos of a station whose light, table and camera are known to the test alone."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.hidden_stations import calibration_of, hidden_station, write_station
from tests.rig_photos import CAMERA as BOARD_CAMERA
from tests.rig_photos import JOINTS, RigPhotographer, looking, standing
from yamsim_cli.calibration.calibration_file import load_calibration
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import pose, rotation_vector
from yamsim_cli.core.images.png import encode_png
from yamsim_cli.core.scene.cameras import fixed_camera
from yamsim_cli.match.match_report import report_data, require_overlap, write_match
from yamsim_cli.match.match_run import MatchRequest, common_view, locate_arms, match_station, scene_camera_of
from yamsim_cli.match.pinhole_view import PinholeView
from yamsim_cli.match.plate import make_plate
from yamsim_cli.match.station_renderer import StationRenderer
from yamsim_cli.photos.overlay.photos import PlacedCamera
from yamsim_cli.photos.overlay.rendered_arms import ArmRenderers

CAMERA = CameraModel(320, 240, ((300.0, 0.0, 165.0), (0.0, 299.0, 117.0), (0.0, 0.0, 1.0)), (-0.1, 0.03, 0.0, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.render
def test_the_matched_scene_is_nearer_to_the_photos(locations: Locations, tmp_path: Path) -> None:
    truth = hidden_station(1, locations, 2, (320, 240))
    for name in ("photos", "masks"):
        (tmp_path / name).mkdir()
    write_station(truth, locations, tmp_path / "photos", tmp_path / "masks", 2)
    scenes = [load_config(SceneConfig, "scenes", name, locations) for name in ("tabletop", "studio")]
    quality = load_config(RenderConfig, "quality", "fast", locations)
    calibration = load_calibration(tmp_path / "calibration.yaml", locations)
    request = MatchRequest(
        sorted((tmp_path / "photos").iterdir()),
        truth.postures,
        placed=calibration.placed_camera(calibration.camera(None, "--calibrated-camera")),
        masks=tmp_path / "masks",
    )
    match = match_station(truth.rig, scenes[0], scenes[1], quality, request, locations, lambda *_: None)
    assert match.light is not None
    assert math.degrees(math.acos(min(1, np.dot(match.light.light.direction, truth.direction)))) < 15
    for photo in match.photos:
        assert photo.iou is not None
        assert photo.iou > 0.92  # small images of primitives
        assert photo.outline_px < 1
        assert photo.arms_after < 0.7 * photo.arms_before
        assert photo.all_after < 0.3 * photo.all_before
    require_overlap(match, 0.92)
    with pytest.raises(SimulationError, match=r"less than --min-iou 0\.9999"):
        require_overlap(match, 0.9999)
    out = tmp_path / "out"
    write_match(match, out)
    assert json.loads((out / "match.json").read_text()) == report_data(match)
    assert "data:image/jpeg" in (out / "match.html").read_text()
    assert load_config(SceneConfig, "scenes", str(out / "matched.yaml"), locations) == match.scene.model_copy(
        update={"name": "matched"}
    )


def test_flags_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    for flags, text in (
        ((), "give either --camera or --calibration"),
        (("--camera", "a", "--min-iou", "0.9"), "--min-iou needs --mask-image"),
        (("--camera", "a", "--calibrated-camera", "b"), "--calibrated-camera needs --calibration"),
    ):
        done = yamsim("match", tmp_path, *flags)
        assert done.code == 2
        assert text in done.err


def test_a_calibrations_camera_is_named_by_a_flag_or_after_the_file(locations: Locations, tmp_path: Path) -> None:
    file, flag = tmp_path / "calibration.yaml", "--calibrated-camera"
    file.write_text(calibration_of(hidden_station(1, locations)))
    for flags, text in (
        (("--calibration", f"{file}:nowhere"), "the calibration has no camera 'nowhere'"),
        (("--calibration", file, flag, "nowhere"), "the calibration has no camera 'nowhere'"),
        (("--calibration", f"{file}:top", flag, "side"), f"names camera 'top', and {flag} 'side'; leave one out"),
    ):
        done = yamsim("match", tmp_path, *flags)
        assert done.code == 2
        assert text in done.err


def test_the_view_shows_straight_lines_where_the_photo_shows_them_bent() -> None:
    """A point's pixel in the photo, undistorted, is its pixel in the view."""
    from yamsim_cli.camera_effects.lens_distortion import project_points

    view = PinholeView.of_camera(CAMERA, pose())
    K = view.intrinsics
    assert (K.fx, K.cx, K.cy) == (K.fy, 159.5, 119.5)
    photo = np.zeros((240, 320), np.uint8)
    point = np.array([[0.12, -0.08, 1.0]])
    u, v = np.rint(project_points(CAMERA, point)[0]).astype(int)
    photo[v - 1 : v + 2, u - 1 : u + 2] = 255
    flat = view.undistort(photo).astype(float)
    row, column = (np.average(np.indices(flat.shape)[k], weights=flat) for k in (0, 1))
    pixels, inside = view.project(point)
    assert inside.all()
    assert pixels[0] == pytest.approx((column, row), abs=0.8)
    corners = view.undistort(np.full((240, 320), 9, np.uint8))
    assert (corners == 9).all()


@pytest.mark.parametrize("span", [0.0, 0.6])
def test_the_scene_camera_of_a_rig_with_two_arms_is_the_view_too(span: float, locations: Locations) -> None:
    z = np.array([-0.8, 0.1, -0.6]) / np.linalg.norm([-0.8, 0.1, -0.6])
    x = np.cross(z, (0.05, 0.02, 1.0))
    x /= np.linalg.norm(x)
    view = PinholeView.of_camera(CAMERA, pose((1.0, 0.1, 0.8), np.column_stack([x, np.cross(z, x), z])))
    scene = load_config(SceneConfig, "scenes", "tabletop", locations)
    scene = scene.model_copy(update={"scene_camera": scene_camera_of(view, span)}).widened_for_arm_distance(span)
    assert scene.scene_camera is not None
    made = fixed_camera("photo", scene.scene_camera)
    np.testing.assert_allclose(made.T_in_body, view.scene_camera.T_in_body, atol=1e-5)
    assert made.fovy_deg == pytest.approx(view.scene_camera.fovy_deg, abs=1e-4)


@pytest.mark.slow
@pytest.mark.render
def test_boards_give_the_camera_s_pose(locations: Locations, tmp_path: Path) -> None:
    T = looking((0.95, -0.12, 0.7), (0.08, 0.0, 0.1))
    with RigPhotographer("russet", locations, BOARD_CAMERA) as photographer:
        shots = [photographer.shoot(T, JOINTS, seed=seed) for seed in (0, 1)]
    paths = [tmp_path / f"{k}.png" for k in range(2)]
    for path, shot in zip(paths, shots, strict=True):
        path.write_bytes(encode_png(shot.image))
    rig = shots[0].rig
    request = MatchRequest(paths, [shots[0].stands], camera=BOARD_CAMERA)
    studio = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    with ArmRenderers(rig, studio, quality, locations) as outlines:
        located = locate_arms(rig, request, [shot.image for shot in shots], [shots[0].stands] * 2, outlines)
    view, notes = common_view(rig, located)
    apart = np.linalg.inv(T) @ view.T_cam_in_world
    assert np.linalg.norm(apart[:3, 3]) < 0.002
    assert np.degrees(np.linalg.norm(rotation_vector(apart[:3, :3]))) < 0.2
    assert notes == ()
    assert all(found.edge_residual is not None and found.edge_residual < 1 for found in located)


@pytest.mark.render
def test_calibrated_arms_are_where_the_calibration_says(locations: Locations, tmp_path: Path) -> None:
    rig = load_config(RigConfig, "rigs", "russet", locations)
    farther = rig.model_copy(update={"margin": rig.margin + 0.03})
    T_world_in_cam = np.linalg.inv(looking((1.1, -0.1, 0.9), (0.1, 0.0, 0.1)))
    offsets = (np.zeros(6), np.full(6, 0.01))
    placed = PlacedCamera(CAMERA, tuple(T_world_in_cam @ farther.T_base_in_world(k) for k in (0, 1)), offsets, 0.0)
    studio, tabletop = (load_config(SceneConfig, "scenes", name, locations) for name in ("studio", "tabletop"))
    quality = load_config(RenderConfig, "quality", "fast", locations)
    request = MatchRequest([tmp_path / "photo.png"], [standing(JOINTS)], placed=placed)
    image = np.zeros((240, 320, 3), np.uint8)
    with ArmRenderers(rig, studio, quality, locations) as outlines:
        (located,) = locate_arms(rig, request, [image], [standing(JOINTS)], outlines)
    np.testing.assert_allclose(list(located.base_poses.values()), placed.T_bases_in_cam)
    view, _ = common_view(rig, [located])
    bases = [view.T_cam_in_world @ T for T in placed.T_bases_in_cam]
    np.testing.assert_allclose(bases[0], rig.T_base_in_world(0), atol=1e-9)
    seen = []
    shift = pose((0.0, farther.arm_origin_y(0) - rig.arm_origin_y(0), 0.0))
    for own, T_bases, T_cam in ((rig, bases, view.T_cam_in_world), (farther, None, shift @ view.T_cam_in_world)):
        camera = PinholeView.of_camera(CAMERA, T_cam).scene_camera
        with StationRenderer(own, tabletop, quality, camera, (160, 120), locations, T_bases) as station:
            station.set_postures(standing(JOINTS))
            seen.append(station.masks()[0])
    assert (seen[0] != seen[1]).sum() < 10 < seen[0].sum() / 100


def test_a_plate_shows_what_the_arms_hide_in_some_photos_and_fills_the_rest() -> None:
    background = np.tile(np.linspace(50, 200, 200).astype(np.uint8)[None, :, None], (100, 1, 3))
    photos, masks = [], []
    for left in (20, 120):
        photo, mask = background.copy(), np.zeros((100, 200), bool)
        mask[30:60, left : left + 30] = mask[80:90, 90:110] = True
        photo[mask] = 0
        photos.append(photo)
        masks.append(mask)
    plate = make_plate(photos, masks)
    np.testing.assert_array_equal(plate.image[:70], background[:70])
    assert 0.01 < plate.filled_share < 0.03
    assert np.abs(plate.image[85, 100].astype(int) - background[85, 100]).max() < 25
