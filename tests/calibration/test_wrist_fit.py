"""The pose and the lens of a wrist camera, from pictures of its gripper."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from yamsim_cli.calibration.camera_start import CameraStart
from yamsim_cli.calibration.episode_pictures import EpisodePictures, TimedPictures
from yamsim_cli.calibration.wrist_fit import _FOCAL, _SIZE, _Rows, _Solution, _wrist_fit, estimate_wrist_camera
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_vector
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.scene.cameras import wrist_camera_pose
from yamsim_cli.core.statistics import Z95
from yamsim_cli.photos.edge_alignment import PoseCorrection
from yamsim_cli.photos.overlay.body_views import BodyRenderer

PICTURES = 12  # of each opening, the fewest that a fit takes
OPENINGS = (0.0, 0.03)  # m


def test_intervals_are_along_the_flanges_axes_and_grow_with_a_far_move_of_the_focal_length() -> None:
    start = CameraStart(CameraModel.from_focal_length(640, 480, 400.0, 0.003), True, False)
    T = pose((0.01, 0.1, 0.2), rotation_from_vector([0.4, -0.8, 1.1]))
    normal = np.diag([1e4, 4e4, 9e4, 1e6, 4e6, 9e6, 1.0, 1e3, 1.0, 1.0, 1.0])
    fits = []
    for move in (0.0, -0.005, 0.0118):
        state = np.zeros(_SIZE)
        state[_FOCAL] = move
        found = _Solution(T, state, _Rows(normal, np.zeros(_SIZE), 1.0, 0.1, 0.1), ())
        fits.append(_wrist_fit("", 0, start, found))
    # Move the flange in the camera by each step in turn, and see how the camera moves on the flange.
    T_cam_in_flange, small, by_step = invert_pose(T), 1e-6, []
    for step in np.eye(6):
        moved = invert_pose(PoseCorrection(small * step, T[:3, 3]).apply_to_pose(T))
        turn = rotation_vector(moved[:3, :3] @ T_cam_in_flange[:3, :3].T)
        by_step.append(np.concatenate([turn, moved[:3, 3] - T_cam_in_flange[:3, 3]]) / small)
    widths = 3.5 * Z95 * np.sqrt((np.array(by_step) ** 2 / np.diag(normal)[:6, None]).sum(axis=0))
    np.testing.assert_allclose(np.concatenate([fits[0].interval.turn, fits[0].interval.position]), widths, rtol=1e-4)
    assert fits[0].k1_95 == pytest.approx(3.5 * Z95 / math.sqrt(1e3))
    assert fits[1].interval.position.tolist() == fits[0].interval.position.tolist()
    assert fits[2].interval.position == pytest.approx(2.0 * fits[0].interval.position, rel=0.01)
    assert fits[2].k1_95 == pytest.approx(2.0 * fits[0].k1_95, rel=0.01)


def test_a_hidden_distortion_is_found_with_the_pose(locations: Locations) -> None:
    rig = load_config(RigConfig, "rigs", "single", locations)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    surroundings = scene, load_config(RenderConfig, "quality", "fast", locations), locations
    (arm,) = rig.arms
    given = CameraModel.from_focal_length(320, 240, 210.0)
    moved = wrist_camera_pose(arm) @ pose((0.002, -0.003, 0.002), rotation_from_vector([0.01, -0.02, 0.01]))
    lens = CameraModel.from_focal_length(320, 240, 210.4)  # 0.2 % more than the camera's file says
    episode = _episode(rig, replace(lens, distortion=(-0.07, 0.0, 0.0, 0.0)), moved, surroundings)
    found = {}
    for name, distortion in (("hidden", ()), ("denied", (0.0,) * 4), ("given", (-0.07, 0.0, 0.0, 0.0))):
        start = CameraStart(replace(given, distortion=distortion), True, bool(distortion))
        fit = estimate_wrist_camera(arm.wrist_camera_name, start, rig, [episode], surroundings, (1.0, 1.0)).fit
        assert fit is not None
        found[name] = fit
    hidden = found["hidden"]
    assert found["denied"].k1_95 is found["given"].k1_95 is None
    assert found["given"].model.distortion[0] == pytest.approx(-0.07, rel=0.02)
    assert hidden.k1_95 is not None and hidden.k1_95 < 0.05
    assert abs(hidden.model.distortion[0] + 0.07) < hidden.k1_95
    assert (np.abs(hidden.T_cam_in_flange[:3, 3] - moved[:3, 3]) < hidden.interval.position).all()
    assert (np.abs(rotation_vector(hidden.T_cam_in_flange[:3, :3] @ moved[:3, :3].T)) < hidden.interval.turn).all()
    assert hidden.interval.position.max() < 0.002
    errors = {name: np.linalg.norm(fit.T_cam_in_flange[:3, 3] - moved[:3, 3]) for name, fit in found.items()}
    assert max(errors["hidden"], errors["given"]) < 0.0006 < 0.5 * errors["denied"]


def _episode(
    rig: RigConfig, lens: CameraModel, T_cam_in_flange: Array, surroundings: tuple[SceneConfig, RenderConfig, Locations]
) -> EpisodePictures:
    """Pictures of the gripper at two openings, before a background of random patches."""
    (arm,) = rig.arms
    count = PICTURES * len(OPENINGS)
    rng, times = np.random.default_rng(0), np.arange(float(count))
    joints = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0]) + rng.uniform(-0.7, 0.7, (count, 6))
    openings = np.repeat(OPENINGS, PICTURES)
    episode = EpisodePictures("", times, (joints,), (openings,), {})
    images: list[Image] = []
    scene, quality, locations = surroundings
    with BodyRenderer(rig, scene, quality, lens, locations) as renderer:
        for time in times:
            postures = episode.postures_at(time)
            renderer.set_poses({0: np.eye(4)}, postures)
            flange = renderer.flange_pose(0)
            renderer.set_poses({0: invert_pose(flange @ T_cam_in_flange)}, postures)
            picture = renderer.render()
            patches = cv2.resize(
                rng.integers(90, 200, (6, 8, 3), np.uint8), (320, 240), interpolation=cv2.INTER_NEAREST
            )
            images.append(np.where(picture.labels[..., None] > 0, picture.colour // 3, patches))
    camera = TimedPictures(times, lambda wanted: [images[k] for k in wanted], None)
    return replace(episode, cameras={arm.wrist_camera_name: camera})
