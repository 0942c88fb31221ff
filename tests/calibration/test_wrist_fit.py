"""The pose and the lens of a wrist camera, from pictures of its gripper."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from yamsim_cli.calibration.camera_start import CameraStart
from yamsim_cli.calibration.episode_pictures import EpisodePictures, TimedPictures
from yamsim_cli.calibration.wrist_fit import _SIZE, _Rows, _Solution, _wrist_fit, estimate_wrist_camera
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.scene.cameras import wrist_camera_pose
from yamsim_cli.photos.overlay.body_views import BodyRenderer

PICTURES = 12  # of each opening, the fewest that a fit takes
OPENINGS = (0.0, 0.03)  # m


def test_intervals_grow_with_a_far_move_of_the_focal_length() -> None:
    start = CameraStart(CameraModel.from_focal_length(640, 480, 400.0, 0.003), True, True)
    widths = []
    for move in (0.0, -0.005, 0.0118):
        state = np.zeros(_SIZE)
        state[6] = move
        found = _Solution(pose((0.0, 0.1, 0.2)), state, _Rows(np.eye(_SIZE), np.zeros(_SIZE), 1.0, 0.1, 0.1), ())
        widths.append(float(_wrist_fit("", 0, start, found).interval.position.max()))
    assert widths[1] == widths[0]
    assert widths[2] == pytest.approx(2.0 * widths[0], rel=0.01)


def test_a_hidden_distortion_is_found_with_the_pose(locations: Locations) -> None:
    rig = load_config(RigConfig, "rigs", "single", locations)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    surroundings = scene, load_config(RenderConfig, "quality", "fast", locations), locations
    (arm,) = rig.arms
    given = CameraModel.from_focal_length(320, 240, 210.0)
    moved = wrist_camera_pose(arm) @ pose((0.002, -0.003, 0.002), rotation_from_vector([0.01, -0.02, 0.01]))
    episode = _episode(rig, replace(given, distortion=(-0.07, 0.0, 0.0, 0.0)), moved, surroundings)
    found = {}
    for is_known in (False, True):
        start = CameraStart(given, True, is_known)
        fit = estimate_wrist_camera(arm.wrist_camera_name, start, rig, [episode], surroundings, (1.0, 1.0)).fit
        assert fit is not None
        found[is_known] = fit
    free, held = found[False], found[True]
    assert (held.k1_95, held.model.distortion) == (None, ())
    assert free.k1_95 is not None
    assert abs(free.model.distortion[0] + 0.07) < min(free.k1_95, 0.03)
    errors = {known: np.linalg.norm(fit.T_cam_in_flange[:3, 3] - moved[:3, 3]) for known, fit in found.items()}
    assert errors[False] < 0.5 * errors[True]
    assert (np.abs(free.T_cam_in_flange[:3, 3] - moved[:3, 3]) < free.interval.position).all()


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
