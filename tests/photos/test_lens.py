"""Projection, viewing rays and distorted pictures, against OpenCV's projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from yamsim_cli.camera_effects.lens_distortion import LensWarp, project_points, viewing_ray_grid, viewing_rays
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.geometry.camera import CameraModel

PLAIN = CameraModel(640, 480, ((600.0, 0.0, 330.0), (0.0, 598.0, 231.0), (0.0, 0.0, 1.0)))
# A webcam; and a wide-angle lens with all eight coefficients of OpenCV's rational model, 93 degrees across.
WEBCAM = CameraModel(640, 480, PLAIN.K, (-0.28, 0.09, 0.001, -0.0015, 0.02))
WIDE = CameraModel(
    1280,
    720,
    ((607.0, 0.0, 638.5), (0.0, 606.5, 366.2), (0.0, 0.0, 1.0)),
    (0.51, -2.74, 4e-4, -2e-4, 1.63, 0.39, -2.56, 1.55),
)
CAMERAS = pytest.mark.parametrize("camera", [PLAIN, WEBCAM, WIDE], ids=["plain", "webcam", "wide"])


def whole_image(camera: CameraModel, step: int = 16) -> np.ndarray:
    """Pixels (n, 2) on a grid up to the corners."""
    x, y = (np.append(np.arange(-0.5, side - 0.5, step), side - 0.5) for side in (camera.width, camera.height))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def opencv_pixels(camera: CameraModel, points: np.ndarray) -> np.ndarray:
    zero = np.zeros(3)
    return cv2.projectPoints(points, zero, zero, np.array(camera.K), np.array(camera.distortion))[0].reshape(-1, 2)


@CAMERAS
def test_a_ray_projects_onto_the_pixel_it_came_from(camera: CameraModel) -> None:
    pixels = whole_image(camera)
    directions = np.column_stack([viewing_rays(camera, pixels), np.ones(len(pixels))])
    depth = np.linspace(0.2, 3.0, len(pixels))[:, None]
    assert np.abs(opencv_pixels(camera, directions * depth) - pixels).max() < 1e-4
    assert np.abs(project_points(camera, directions * depth) - pixels).max() < 1e-4


@CAMERAS
def test_the_ray_field_agrees_with_single_rays(camera: CameraModel) -> None:
    x, y = np.arange(camera.width * 2) / 2 - 0.25, np.arange(camera.height * 2) / 2 - 0.25
    field = viewing_ray_grid(camera, x, y)
    assert field.shape == (len(y), len(x), 2)
    exact = viewing_rays(camera, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(field.shape)
    # In pixels, the error of interpolation and single precision together.
    assert np.abs(field - exact).max() * camera.mean_focal_length < 5e-4


def test_empty_arrays_give_empty_arrays() -> None:
    assert viewing_rays(WEBCAM, np.zeros((0, 2))).shape == project_points(WEBCAM, np.zeros((0, 3))).shape == (0, 2)


@CAMERAS
@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_points_of_an_ideal_picture_come_out_where_the_lens_has_them(camera: CameraModel, supersample: int) -> None:
    warp = LensWarp(camera, supersample)
    ideal = warp.ideal
    # A soft blob for each viewing ray, where the ideal camera has it.
    pixels = np.stack(np.meshgrid(np.linspace(40, camera.width - 40, 5), np.linspace(40, camera.height - 40, 4)), -1)
    pixels = pixels.reshape(-1, 2) + 0.3
    directions = viewing_rays(camera, pixels)
    picture = np.zeros((ideal.height, ideal.width), np.float32)
    rows, columns = np.mgrid[: ideal.height, : ideal.width].astype(np.float32)
    for ray in directions:
        x, y = ray * (ideal.fx, ideal.fy) + (ideal.cx, ideal.cy)
        near = (slice(max(0, int(y) - 40), int(y) + 40), slice(max(0, int(x) - 40), int(x) + 40))
        distance = (columns[near] - x) ** 2 + (rows[near] - y) ** 2
        picture[near] += 250 * np.exp(-distance / (2 * (4 * supersample) ** 2))
    bent = warp.distort_picture(np.round(picture).astype(np.uint8)).astype(np.float64)
    assert bent.shape == (camera.height, camera.width)
    for x, y in pixels:
        patch = np.s_[round(y) - 14 : round(y) + 15, round(x) - 14 : round(x) + 15]
        weights = bent[patch]
        r, c = np.mgrid[patch]
        found = np.array([(weights * c).sum(), (weights * r).sum()]) / weights.sum()
        # A blob on a distorted grid is itself distorted a little.
        assert np.linalg.norm(found - (x, y)) < 0.06


@CAMERAS
def test_distorting_labels_creates_no_new_labels(camera: CameraModel) -> None:
    warp = LensWarp(camera, 2)
    rng = np.random.default_rng(0)
    ideal = rng.integers(0, 3, (warp.ideal.height // 8 + 1, warp.ideal.width // 8 + 1)).repeat(8, 0).repeat(8, 1)
    labels = ideal[: warp.ideal.height, : warp.ideal.width].astype(np.uint8)
    bent = warp.distort_picture(labels, nearest=True)
    assert set(np.unique(bent)) == {0, 1, 2}
    assert bent.shape == (camera.height, camera.width)


@CAMERAS
def test_flattening_undoes_the_lens(camera: CameraModel) -> None:
    """A distorted photo, undistorted, is the ideal picture, wherever the lens sees."""
    warp = LensWarp(camera, 1)
    rows, columns = np.mgrid[: warp.ideal.height, : warp.ideal.width]
    picture = (128 + 60 * np.sin(columns / 25) + 60 * np.cos(rows / 31)).astype(np.uint8)
    flat = warp.undistort_photo(warp.distort_picture(picture))
    picture, ideal = warp.coarse_picture(picture), warp.coarse_intrinsics
    assert flat.shape == picture.shape
    seen = np.round(viewing_rays(camera, whole_image(camera, 5)) * (ideal.fx, ideal.fy) + (ideal.cx, ideal.cy)).astype(
        int
    )
    inner = (seen > 5).all(axis=1) & (seen < (ideal.width - 6, ideal.height - 6)).all(axis=1)
    at = tuple(seen[inner].T[::-1])
    off_border = np.abs(flat[at].astype(int) - picture[at])
    assert np.percentile(off_border, 98) <= 4


@pytest.mark.parametrize("supersample", [2, 3])
def test_every_nth_pixel_of_the_ideal_picture_is_the_coarse_cameras(supersample: int) -> None:
    warp = LensWarp(WEBCAM, supersample)
    fine, coarse = warp.ideal, warp.coarse_intrinsics
    picture = warp.coarse_picture(np.zeros((fine.height, fine.width)))
    assert picture.shape == (coarse.height, coarse.width)
    k = 37
    ray = (k * supersample - fine.cx) / fine.fx
    assert ray * coarse.fx + coarse.cx == pytest.approx(k)


def test_the_coarse_picture_is_cut_to_a_camera_whose_principal_point_is_at_a_side() -> None:
    cut = CameraModel(376, 480, ((520.0, 0.0, 55.0), (0.0, 520.0, 239.5), (0.0, 0.0, 1.0)))
    warp = LensWarp(cut, 2)
    coarse = warp.coarse_intrinsics
    assert 376 <= coarse.width < 376 * 1.05
    assert warp.ideal.width > 2 * 600
    photo = np.tile(np.linspace(0, 250, 376), (480, 1)).astype(np.uint8)
    assert warp.undistort_photo(photo).shape == (coarse.height, coarse.width)
    # The columns of the ideal picture, as numbers: where the coarse camera sees a ray, it shows the ideal column.
    columns = np.tile(np.arange(warp.ideal.width), (warp.ideal.height, 1))
    shown = warp.coarse_picture(columns)
    assert shown.shape == (coarse.height, coarse.width)
    rays = (np.arange(coarse.width) - coarse.cx) / coarse.fx
    np.testing.assert_allclose(shown[0], rays * warp.ideal.fx + warp.ideal.cx, atol=1e-6)
    assert warp.cut_to_view(columns)[0, ::2].tolist() == shown[0].tolist()


def test_the_ideal_picture_holds_all_that_the_lens_sees() -> None:
    for camera in (PLAIN, WEBCAM, WIDE):
        ideal = LensWarp(camera).ideal
        pixels = viewing_rays(camera, whole_image(camera)) * (ideal.fx, ideal.fy) + (ideal.cx, ideal.cy)
        assert (pixels > -0.5).all()
        assert (pixels < (ideal.width - 0.5, ideal.height - 0.5)).all()


def test_a_lens_too_wide_for_a_pinhole_is_refused() -> None:
    K = ((80.0, 0.0, 320.0), (0.0, 80.0, 240.0), (0.0, 0.0, 1.0))
    with pytest.raises(ConfigError, match="too wide for a pinhole model; at most 75: check K and distortion"):
        LensWarp(CameraModel(640, 480, K))


@CAMERAS
def test_an_undistorted_photo_says_what_it_does_not_show(camera: CameraModel) -> None:
    warp = LensWarp(camera)
    flat = warp.coarse_intrinsics
    x, y = np.meshgrid(np.arange(flat.width), np.arange(flat.height))
    rays = np.stack([(x - flat.cx) / flat.fx, (y - flat.cy) / flat.fy, np.ones(x.shape)], axis=-1)
    u, v = np.moveaxis(project_points(camera, rays.reshape(-1, 3)).reshape(*x.shape, 2), -1, 0)
    beyond = np.maximum.reduce([-u, u - (camera.width - 1), -v, v - (camera.height - 1)])  # px, if positive
    clear = np.abs(beyond) > 0.01
    assert (warp.outside_photo == (beyond > 0))[clear].all()
    assert 0.02 < warp.outside_photo.mean() < 0.3
