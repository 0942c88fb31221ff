"""Project points, viewing rays and pictures through a distorted lens."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import ConfigError
from ..core.geometry.camera import CameraModel, Intrinsics
from ..core.geometry.se3 import Array

# OpenCV's default of 5 iterations is off by tenths of a pixel with strong distortion.
_UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)

_RAY_SPACING = 8  # px between exact rays; interpolated ones are off by at most 5e-4 px
_MARGIN = 0.01  # share of the largest angle by which an ideal picture shows more than the real camera, on each side
_MAX_HALF_ANGLE = math.radians(75.0)  # rad from the axis; a wider pinhole picture would be mostly border


def project_points(camera: CameraModel, points_in_cam: ArrayLike) -> Array:
    """Return pixels (n, 2) of points (n, 3), m, in front of the camera, in the camera frame."""
    points = np.asarray(points_in_cam, dtype=np.float64).reshape(-1, 1, 3)
    if len(points) == 0:
        return np.zeros((0, 2))
    zero = np.zeros(3)
    if camera.fisheye:
        pixels, _ = cv2.fisheye.projectPoints(points, zero, zero, np.array(camera.K), np.array(camera.distortion))
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    pixels, _ = cv2.projectPoints(points, zero, zero, np.array(camera.K), np.array(camera.distortion))
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def viewing_rays(camera: CameraModel, pixels: ArrayLike) -> Array:
    """Return viewing rays (n, 2), x/z and y/z in the camera frame, of pixels (n, 2)."""
    points = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    if len(points) == 0:
        return np.zeros((0, 2))
    if not camera.distortion:
        (fx, skew, cx), (_, fy, cy), _ = camera.K
        y = (points[:, 0, 1] - cy) / fy
        return np.column_stack([(points[:, 0, 0] - cx - skew * y) / fx, y])
    K, distortion = np.array(camera.K), np.array(camera.distortion)
    if camera.fisheye:
        found = cv2.fisheye.undistortPoints(points, K, distortion, criteria=_UNDISTORT_CRITERIA)
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)
    # OpenCV 4 accepts criteria only in another function.
    if older := getattr(cv2, "undistortPointsIter", None):
        found = older(points, K, distortion, np.eye(3), np.eye(3), _UNDISTORT_CRITERIA)
    else:
        found = cv2.undistortPoints(points, K, distortion, criteria=_UNDISTORT_CRITERIA)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def viewing_ray_grid(camera: CameraModel, x: ArrayLike, y: ArrayLike) -> NDArray[np.float32]:
    """Return viewing rays (rows, columns, 2) of evenly spaced pixel columns `x` and rows `y`."""
    columns, rows = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if not camera.distortion:
        across, down = np.meshgrid(columns, rows)
        field = viewing_rays(camera, np.stack([across, down], axis=-1).reshape(-1, 2))
        return field.reshape(len(rows), len(columns), 2).astype(np.float32)
    # Cubic interpolation needs two knots beyond the grid on each side.
    knots_x, knots_y = (
        np.arange(line[0] - 2 * _RAY_SPACING, line[-1] + 3 * _RAY_SPACING, _RAY_SPACING) for line in (columns, rows)
    )
    across, down = np.meshgrid(knots_x, knots_y)
    knots = viewing_rays(camera, np.stack([across, down], axis=-1).reshape(-1, 2)).reshape(
        len(knots_y), len(knots_x), 2
    )
    # `cv2.remap` would round to 1/32 of the spacing, a quarter of a pixel.
    by_row, by_column = _cubic_weights(rows, knots_y), _cubic_weights(columns, knots_x)
    field = np.stack([by_row @ knots[..., k] @ by_column.T for k in (0, 1)], axis=-1)
    return field.astype(np.float32)


def _cubic_weights(at: Array, knots: Array) -> Array:
    place = (at - knots[0]) / (knots[1] - knots[0])
    first = np.floor(place).astype(int)
    t = place - first
    weights = np.zeros((len(at), len(knots)))
    terms = (-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3)
    for k, term in enumerate(terms):
        weights[np.arange(len(at)), first + k - 1] = term / 2
    return weights


class LensWarp:
    """Warps pictures between an ideal, centred pinhole camera and a real one at the same pose.

    Attributes:
        ideal: the pinhole camera, whose view contains the real one.
        supersample: ideal pixels per real pixel along each axis, at the image's centre.

    Args:
        size: width and height of the ideal camera, px, which then has the largest focal length that fits.

    Raises:
        ConfigError: the lens is too wide for a pinhole picture.
    """

    def __init__(self, camera: CameraModel, supersample: int = 1, size: tuple[int, int] | None = None) -> None:
        edge_x = np.linspace(-0.5, camera.width - 0.5, 65)
        edge_y = np.linspace(-0.5, camera.height - 0.5, 65)
        border = np.concatenate(
            [
                np.column_stack([np.tile(edge_x, 2), np.repeat(edge_y[[0, -1]], 65)]),
                np.column_stack([np.repeat(edge_x[[0, -1]], 65), np.tile(edge_y, 2)]),
            ]
        )
        rays = viewing_rays(camera, border)
        widest = np.abs(rays).max(axis=0)
        reach = widest * (1 + _MARGIN)
        if not np.isfinite(reach).all() or reach.max() > math.tan(_MAX_HALF_ANGLE):
            raise ConfigError(
                f"the camera sees {math.degrees(math.atan(float(reach.max()))):.0f} degrees off its axis, too wide for "
                f"a pinhole model; at most {math.degrees(_MAX_HALF_ANGLE):.0f}: check K and distortion"
            )
        if size is None:
            focal = camera.mean_focal_length * supersample
            width, height = (2 * math.ceil(float(r) * focal) for r in reach)
        else:
            width, height = size
            focal = min(width / 2 / float(reach[0]), height / 2 / float(reach[1]))
        self.ideal = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        self._camera = camera
        self.supersample = supersample
        self._window = self._coarse_window(rays, _MARGIN * widest)
        self._known_maps: dict[int, tuple[NDArray[np.float32], NDArray[np.float32]]] = {}

    @property
    def fovy(self) -> float:
        """The ideal camera's vertical field of view, rad."""
        return 2 * math.atan(self.ideal.height / 2 / self.ideal.fy)

    def undistort_photo(self, photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort a photo into a picture of the camera `coarse_intrinsics`."""
        flat = cv2.remap(photo, *self._undistortion_maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(flat, dtype=np.uint8)

    @cached_property
    def outside_photo(self) -> NDArray[np.bool_]:
        """Mask (height, width) of the pixels of an undistorted photo that the photo does not show."""
        x, y = self._undistortion_maps
        shown = (x >= 0) & (x <= self._camera.width - 1) & (y >= 0) & (y <= self._camera.height - 1)
        return np.asarray(~shown)

    @cached_property
    def _undistortion_maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The real camera's x and y, px, at each pixel (height, width) of `coarse_intrinsics`."""
        ideal, K = self.coarse_intrinsics, np.array(self._camera.K)
        x, y = cv2.initUndistortRectifyMap(
            K, np.array(self._camera.distortion), np.eye(3), ideal.K, (ideal.width, ideal.height), cv2.CV_32FC1
        )
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    @property
    def coarse_intrinsics(self) -> Intrinsics:
        """The camera of every `supersample`-th row and column of the ideal picture, cut to what the real one sees."""
        fine, step, (rows, columns) = self.ideal, self.supersample, self._window
        return Intrinsics(
            columns.stop - columns.start,
            rows.stop - rows.start,
            fine.fx / step,
            fine.fy / step,
            fine.cx / step - columns.start,
            fine.cy / step - rows.start,
        )

    def _coarse_window(self, rays: Array, margin: Array) -> tuple[slice, slice]:
        """Return the rows and columns that contain the rays (n, 2) of the real camera's border and a margin (2,).

        If the principal point is not in the middle, as in cut pictures, the ideal picture has more at one side.
        """
        fine, step = self.ideal, self.supersample
        found = []
        for axis, size, focal, middle in ((1, fine.height, fine.fy, fine.cy), (0, fine.width, fine.fx, fine.cx)):
            ends = rays[:, axis].min() - margin[axis], rays[:, axis].max() + margin[axis]
            first, last = ((middle + end * focal) / step for end in ends)
            found.append(slice(max(math.floor(first), 0), min(math.ceil(last) + 1, -(-size // step))))
        return found[0], found[1]

    def coarse_picture(self, ideal: NDArray[Any]) -> NDArray[Any]:
        """Return the picture of the camera `coarse_intrinsics` in an ideal picture (height, width[, channels])."""
        step = self.supersample
        return np.ascontiguousarray(self.cut_to_view(ideal)[::step, ::step])

    def cut_to_view(self, ideal: NDArray[Any]) -> NDArray[Any]:
        """Return the part of an ideal picture that `coarse_intrinsics` shows, with all its rows and columns."""
        rows, columns = (slice(part.start * self.supersample, part.stop * self.supersample) for part in self._window)
        return ideal[rows, columns]

    def distort_picture(self, ideal: NDArray[np.uint8], nearest: bool = False) -> NDArray[np.uint8]:
        """Return the real camera's picture (height, width[, channels]) of an ideal one; `nearest` for masks and ids."""
        camera, fine = self._camera, 1 if nearest else self.supersample
        bent = self.remap(ideal, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR, fine)
        if fine > 1:
            bent = cv2.resize(bent, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return np.asarray(bent, dtype=np.uint8)

    def remap(self, ideal: NDArray[Any], interpolation: int, fine: int = 1) -> NDArray[Any]:
        """Return the values of an ideal picture at the real camera's pixels, or at `fine` times as many."""
        map_x, map_y = self._distortion_maps(fine)
        return np.asarray(cv2.remap(ideal, map_x, map_y, interpolation, borderMode=cv2.BORDER_REPLICATE))

    def _distortion_maps(self, fine: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        if fine in self._known_maps:
            return self._known_maps[fine]
        camera, offset = self._camera, (fine - 1) / 2
        x = (np.arange(camera.width * fine) - offset) / fine
        y = (np.arange(camera.height * fine) - offset) / fine
        field = viewing_ray_grid(camera, x, y)
        map_x = field[..., 0] * np.float32(self.ideal.fx) + np.float32(self.ideal.cx)
        map_y = field[..., 1] * np.float32(self.ideal.fy) + np.float32(self.ideal.cy)
        self._known_maps[fine] = map_x, map_y
        return map_x, map_y
