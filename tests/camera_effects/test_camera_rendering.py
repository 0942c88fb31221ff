"""Cameras with a lens against cv2 and against rays in the scene; delay, noise and shutter of whole images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from tests.attempts import planned
from yamsim_cli.camera_effects.config import CameraEffects
from yamsim_cli.camera_rendering import LensIntrinsics
from yamsim_cli.core.attempt_data import Attempt
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.dataset_paths import image_path
from yamsim_cli.core.episode.attempt_payload import encode_images, render_recorded_images
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.rendering.frame_truth import measure_frame

pytestmark = pytest.mark.render

CAMERA = "scene_camera"
SIZE = (160, 120)
LENSES: dict[str, dict[str, Any]] = {
    "standard": {"distortion": [-0.25, 0.08, 0.002, -0.001, 0.0], "principal_point": [0.03, -0.02]},
    "fisheye": {"lens": "fisheye", "distortion": [0.02, -0.01, 0.0, 0.0], "principal_point": [0.01, 0.02]},
    "principal point": {"principal_point": [0.1, -0.05]},
    "crop": {"distortion": [-0.2, 0.05, 0.0, 0.0], "crop": [0.1, 0.2, 0.8, 0.9], "letterbox": 1.2},
}

MakeSimulator = Callable[[dict[str, Any] | None], Simulator]


@pytest.fixture(scope="module")
def make_simulator(make_config: Callable[..., RecordConfig], locations: Locations) -> Any:
    made: list[Simulator] = []

    def make(effects: dict[str, Any] | None) -> Simulator:
        entries = [{"effects": effects}] if effects else []
        config = make_config(
            {
                ("image", "size_px"): list(SIZE),
                ("render",): "fast",
                ("truth",): True,
                ("camera_effects",): entries,
            }
        )
        made.append(Simulator(Session(config, locations).without_meshes()))
        return made[-1]

    yield make
    for simulator in made:
        simulator.close()


@pytest.fixture(scope="module")
def motion(make_simulator: MakeSimulator) -> tuple[Attempt, list[Array]]:
    """An attempt, and the positions of its frames 20 to 31, in which the arm moves."""
    done = planned(make_simulator(None), 3, 0)
    return done.attempt, [state.qpos for state in done.recorded_states][20:32]


def images_of(simulator: Simulator, motion: tuple[Attempt, list[Array]]) -> list[np.ndarray]:
    return [image.copy() for _, _, image in render_recorded_images(simulator, *motion)]


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_projected_as_cv2_projects_them(lens: str, make_simulator: MakeSimulator) -> None:
    intrinsics = make_simulator(LENSES[lens]).intrinsics(CAMERA)
    assert isinstance(intrinsics, LensIntrinsics)
    points = np.random.default_rng(0).uniform((-0.5, -0.4, 1.0), (0.5, 0.4, 1.5), (50, 3))
    K, D, zero = intrinsics.K, np.array(LENSES[lens].get("distortion", ())), np.zeros(3)
    project = cv2.fisheye.projectPoints if lens == "fisheye" else cv2.projectPoints
    wanted = project(points[:, None], zero, zero, K, D)[0].reshape(-1, 2)
    np.testing.assert_allclose(intrinsics.project(points), wanted, atol=1e-6)
    np.testing.assert_allclose(intrinsics.rays(wanted), points / points[:, 2:], atol=1e-6)


@pytest.mark.parametrize("lens", ["standard", "principal point"])
def test_cv2_undistorts_the_image_to_that_of_the_pinhole(
    lens: str, make_simulator: MakeSimulator, motion: tuple[Attempt, list[Array]]
) -> None:
    plain, bent = make_simulator(None), make_simulator(LENSES[lens])
    attempt, positions = motion
    one = images_of(plain, (attempt, positions[:1]))[0]
    other = images_of(bent, (attempt, positions[:1]))[0]
    K, D = bent.intrinsics(CAMERA).K, np.array(LENSES[lens].get("distortion", ()))
    flat = cv2.undistort(other, K, D, newCameraMatrix=plain.intrinsics(CAMERA).K)
    inside = cv2.undistort(np.full_like(other, 255), K, D, newCameraMatrix=plain.intrinsics(CAMERA).K)[..., 0] == 255
    inside &= cv2.erode(inside.astype(np.uint8), np.ones((5, 5))) > 0
    assert inside.mean() > 0.7
    apart = np.abs(flat.astype(float) - one)[inside].mean()
    assert apart < 4.0 < np.abs(other.astype(float) - one)[inside].mean()


@pytest.mark.parametrize("lens", LENSES)
def test_depth_and_labels_are_those_of_rays_through_the_lens(
    lens: str, make_simulator: MakeSimulator, motion: tuple[Attempt, list[Array]]
) -> None:
    simulator, (attempt, positions) = make_simulator(LENSES[lens]), motion
    simulator.apply_randomization(attempt)
    replica, labels = simulator.state_replay, simulator.labels
    assert labels is not None
    replica.set_state(positions[0])
    scene = simulator.scene
    truth = measure_frame(replica.data, CAMERA, simulator.renderer, labels, scene.T_base_in_world)
    view, groups = replica.data.cam(CAMERA), np.array([1, 1, 1, 0, 0, 0], np.uint8)
    R, hit = opencv_from_mujoco(view.xmat), np.zeros(1, np.int32)
    rng = np.random.default_rng(1)
    pixels = np.column_stack([rng.integers(0, SIZE[0], 300), rng.integers(0, SIZE[1], 300)])
    # At an outline, half of the pixels show another surface than the ray through their middle.
    inside = cv2.erode(truth.labels, np.ones((3, 3))) == cv2.dilate(truth.labels, np.ones((3, 3)))
    right, clear, near = [], [], []
    for (u, v), ray in zip(pixels, simulator.intrinsics(CAMERA).rays(pixels), strict=True):
        z = mujoco.mj_ray(scene.model, replica.data, view.xpos, R @ ray, groups, 1, -1, hit)
        seen = labels.label_of_geom[hit[0]] if hit[0] >= 0 else 0
        if seen == 0:
            continue
        right.append(truth.labels[v, u] == seen)
        if inside[v, u]:
            clear.append(right[-1])
            near.append(abs(truth.depth_mm[v, u] / 1000 - z))
    assert len(right) > 80
    assert np.mean(right) > 0.92
    assert np.mean(clear) > 0.98 and len(clear) > 40
    assert np.percentile(near, 90) < 0.002


def test_a_crop_between_bars_is_the_same_part_of_the_whole_image(
    make_simulator: MakeSimulator, motion: tuple[Attempt, list[Array]]
) -> None:
    attempt, positions = motion
    whole = images_of(make_simulator(None), (attempt, positions[:1]))[0]
    square = {"crop": [0.125, 0.0, 0.875, 1.0], "letterbox": 1.0}
    image = images_of(make_simulator(square), (attempt, positions[:1]))[0]
    np.testing.assert_allclose(image[:, 20:140].astype(int), whole[:, 20:140], atol=2)
    noisy = images_of(make_simulator(square | {"full_well_e": 500, "exposure_ev": 1.0}), (attempt, positions[:1]))[0]
    for each in (image, noisy):
        assert not each[:, :20].any() and not each[:, 140:].any()
    assert np.abs(noisy[:, 20:140].astype(int) - image[:, 20:140]).mean() > 5


def test_bars_leave_the_picture_the_sensors_field_of_view(make_simulator: MakeSimulator) -> None:
    plain = make_simulator(None).intrinsics(CAMERA)
    wide = make_simulator({"letterbox": 2.0}).intrinsics(CAMERA)
    assert wide.fy == pytest.approx(plain.fy * 80 / 120) and wide.fx == pytest.approx(wide.fy)
    assert (wide.cx, wide.cy) == pytest.approx((plain.cx, plain.cy))


def test_key_frames_of_a_video_need_its_quantization() -> None:
    with pytest.raises(ValueError, match="h264_key_frames needs h264_qp"):
        CameraEffects(h264_key_frames=10)
    assert CameraEffects.model_validate(CameraEffects().model_dump()).h264_qp is None


@pytest.mark.parametrize("crop", [(0.2, 0.0, 0.2, 1.0), (0.0, 0.9, 1.0, 0.1)])
def test_a_crop_without_area_is_refused(crop: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="crop is left, top, right, bottom"):
        CameraEffects(crop=crop)


@pytest.mark.slow
def test_a_delay_shows_earlier_frames(make_simulator: MakeSimulator, motion: tuple[Attempt, list[Array]]) -> None:
    plain, late = (images_of(make_simulator(effects), motion) for effects in (None, {"delay_frames": 2}))
    for k, image in enumerate(late):
        np.testing.assert_array_equal(image, plain[max(0, k - 2)])
    assert not np.array_equal(plain[5], plain[7])


@pytest.mark.slow
def test_a_slow_shutter_mixes_the_states_before_the_frame(
    make_simulator: MakeSimulator, motion: tuple[Attempt, list[Array]]
) -> None:
    """Over a whole frame period, with two states, the image is the mean of those of two frames."""
    plain = images_of(make_simulator(None), motion)
    period = 64.0  # ms
    mixed = images_of(make_simulator({"exposure_ms": period, "shutter_samples": 2}), motion)
    mean = (plain[5].astype(float) + plain[6]) / 2
    assert np.abs(mixed[6] - mean).max() <= 1.0
    rolling = images_of(make_simulator({"readout_ms": period, "shutter_samples": 2}), motion)
    np.testing.assert_array_equal(rolling[6][-1], plain[6][-1])
    np.testing.assert_array_equal(rolling[6][0], plain[5][0])


@pytest.mark.slow
def test_files_have_the_same_bytes_again(make_simulator: MakeSimulator, motion: tuple[Attempt, list[Array]]) -> None:
    effects = LENSES["fisheye"] | {
        "full_well_e": 2000,
        "jpeg_quality": 60,
        "h264_qp": 30,
        "exposure_ms": 10,
        "readout_ms": 10,
        "delay_frames": 1,
    }
    attempt, positions = motion
    simulator = make_simulator(effects)
    first = encode_images(simulator, attempt, positions[:4])
    assert first == encode_images(make_simulator(effects), attempt, positions[:4])
    assert first == encode_images(simulator, attempt, positions[:4]), "the video begins again"
    noisy = make_simulator({"full_well_e": 2000})
    still = [positions[0]] * 3
    files = encode_images(noisy, attempt, still)
    assert len({files[image_path(CAMERA, k)] for k in range(3)}) == 3, "each frame has its own noise"


def test_keypoints_far_outside_do_not_fold_back(make_simulator: MakeSimulator) -> None:
    """The polynomial of this lens turns back at x/z = 1.15."""
    intrinsics = make_simulator(LENSES["standard"]).intrinsics(CAMERA)
    places = intrinsics.project(np.array([[3.0, 0.0, 1.0], [6.0, 0.0, 1.0]]))
    assert (places[:, 0] > SIZE[0]).all()
