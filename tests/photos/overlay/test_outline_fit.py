"""Poses improved by the photo's edges, within the boards' uncertainty."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.rig_photos import RigPhoto
from yamsim_cli.camera_effects.lens_distortion import project_points
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector
from yamsim_cli.core.images.image_files import to_grey
from yamsim_cli.photos.overlay.outline_fit import mask_iou, refine_poses, score_outlines
from yamsim_cli.photos.overlay.photo_arm_poses import STATUS_RECORDED, ArmBasePose, RigInPhoto
from yamsim_cli.photos.overlay.photo_cameras import PhotoCamera
from yamsim_cli.photos.overlay.rendered_arms import ArmRenderer

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def renderer(russet_shot: RigPhoto, locations: Locations) -> Iterator[ArmRenderer]:
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    with ArmRenderer(russet_shot.rig, scene, quality, russet_shot.camera, locations) as renderer:
        yield renderer


def moved(T: Array, shift: tuple[float, float, float], turn: tuple[float, float, float]) -> Array:
    return pose(T[:3, 3] + shift, rotation_from_vector(list(turn)) @ T[:3, :3])


def with_poses(shot: RigPhoto, poses: dict[int, Array]) -> RigInPhoto:
    """A result whose poses are known to a degree and a centimetre only."""
    arms = tuple(
        ArmBasePose(arm.name, None, STATUS_RECORDED, None, poses.get(k)) for k, arm in enumerate(shot.rig.arms)
    )
    return RigInPhoto(Path("p.png"), PhotoCamera.from_calibration(shot.camera, "file"), "file", arms, ())


def miss_px(shot: RigPhoto, k: int, T: Array) -> float:
    """Rms distance of the drawn arm's neighbourhood from its place."""
    points = np.array([[x, y, z, 1.0] for x in (0.0, 0.3) for y in (-0.1, 0.1) for z in (0.05, 0.35)])
    pixels = [project_points(shot.camera, (points @ pose.T)[:, :3]) for pose in (T, shot.T_base_in_cam(k))]
    return float(np.sqrt(((pixels[0] - pixels[1]) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize(
    ("shift", "turn"),
    [
        ((0.008, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((-0.004, 0.006, 0.0), (0.0, 0.0, 0.008)),
        ((0.006, -0.007, 0.008), (0.006, -0.004, -0.006)),
    ],
)
def test_a_pose_that_is_off_by_pixels_is_brought_back(
    russet_shot: RigPhoto, renderer: ArmRenderer, shift: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    grey = to_grey(russet_shot.image)
    off = {k: moved(russet_shot.T_base_in_cam(k), shift, turn) for k in (0, 1)}
    better = refine_poses(with_poses(russet_shot, off), renderer, russet_shot.stands, grey, together=False)
    for k in (0, 1):
        before, after = miss_px(russet_shot, k, off[k]), miss_px(russet_shot, k, better.base_poses[k])
        assert before > 3.0
        assert after < before / 5


def test_arms_with_a_trusted_margin_are_corrected_by_one_motion(russet_shot: RigPhoto, renderer: ArmRenderer) -> None:
    grey = to_grey(russet_shot.image)
    off = {k: moved(russet_shot.T_base_in_cam(k), (0.008, 0.0, 0.0), (0, 0, 0)) for k in (0, 1)}
    apart = invert_pose(off[0]) @ off[1]
    better = refine_poses(with_poses(russet_shot, off), renderer, russet_shot.stands, grey, together=True).base_poses
    assert invert_pose(better[0]) @ better[1] == pytest.approx(apart, abs=1e-9)
    for k in (0, 1):
        assert miss_px(russet_shot, k, better[k]) < miss_px(russet_shot, k, off[k]) / 5


def test_an_arm_without_a_pose_stays_so(russet_shot: RigPhoto, renderer: ArmRenderer) -> None:
    one = with_poses(russet_shot, {1: russet_shot.T_base_in_cam(1)})
    better = refine_poses(one, renderer, russet_shot.stands, to_grey(russet_shot.image), together=False)
    assert list(better.base_poses) == [1]
    assert better.arms[0] == one.arms[0]


def test_the_score_says_how_many_pixels_it_is_off(russet_shot: RigPhoto, renderer: ArmRenderer) -> None:
    grey = to_grey(russet_shot.image)
    scores = []
    for mm in (0, 4, 8):
        poses = {k: moved(russet_shot.T_base_in_cam(k), (0.001 * mm, 0, 0), (0, 0, 0)) for k in (0, 1)}
        renderer.set_poses(poses, russet_shot.stands)
        result = score_outlines(with_poses(russet_shot, poses), renderer, grey)
        scores.append(result.edge_residual)
        assert all(arm.edge_residual is not None for arm in result.arms)
    assert scores[0] < 0.4
    # Four millimetres are 2.5 px here; an edge along the shift does not show it.
    assert 1.0 < scores[1] < 2.6
    assert scores[1] < scores[2] < 5.5


def test_an_arm_in_front_of_the_other_is_not_blamed_for_it(russet_shot: RigPhoto, renderer: ArmRenderer) -> None:
    """Labels say which arm is visible, and an outline stops where the other arm covers it."""
    renderer.set_poses({k: russet_shot.T_base_in_cam(k) for k in (0, 1)}, russet_shot.stands)
    both = renderer.undistorted_label_image()
    renderer.set_poses({0: russet_shot.T_base_in_cam(0)}, russet_shot.stands)
    one = renderer.undistorted_label_image()
    assert set(np.unique(both)) == {0, 1, 2}
    assert set(np.unique(one)) == {0, 1}
    assert (one[both == 1] == 1).all()


def test_overlap_is_the_intersection_over_the_union() -> None:
    one, other = np.zeros((10, 10), bool), np.zeros((10, 10), bool)
    assert mask_iou(one, other) == 1.0
    one[:5] = True
    assert mask_iou(one, other) == 0.0
    other[:, :5] = True
    assert mask_iou(one, other) == pytest.approx(25 / 75)
