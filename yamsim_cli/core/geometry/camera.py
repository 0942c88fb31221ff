"""Pinhole cameras in OpenCV's convention: x right, y down, z forward; (0, 0) is the centre of the top-left pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .se3 import Array

_FLIP_YZ = np.diag([1.0, -1.0, -1.0])  # MuJoCo cameras look along -z with +y up; the rotation is its own inverse


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion: image size in pixels, focal lengths and principal point in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_fovy(cls, width: int, height: int, fovy: float) -> Intrinsics:
        """The camera with which MuJoCo renders a vertical field of view of `fovy` radians: square pixels, centred.

        Pixel centres are whole numbers, so the principal point is at `(width - 1) / 2`.
        """
        focal = height / 2 / math.tan(fovy / 2)
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def K(self) -> Array:
        """The camera matrix (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class CameraModel:
    """A real camera as OpenCV calibrates it: pinhole with lens distortion.

    Attributes:
        width, height: image size, px.
        K: the camera matrix, row by row.
        distortion: coefficients in OpenCV's order `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]`; empty for none.
        focal_sigma: relative standard deviation of the focal length; a careful calibration gives 0.003.
        intrinsics_covariance: for an estimated camera, the covariance (4, 4), row by row, of the logarithm of the focal length, the
            principal point (in focal lengths, right and down) and `k1`; empty if only `focal_sigma` is known.
    """

    width: int
    height: int
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    distortion: tuple[float, ...] = ()
    focal_sigma: float = 0.003
    intrinsics_covariance: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def pinhole(cls, width: int, height: int, focal: float, focal_sigma: float = 0.003) -> CameraModel:
        """A camera without distortion: square pixels, and the principal point in the image's centre."""
        K = ((focal, 0.0, (width - 1) / 2), (0.0, focal, (height - 1) / 2), (0.0, 0.0, 1.0))
        return cls(width, height, K, focal_sigma=focal_sigma)

    @property
    def focal(self) -> float:
        """The geometric mean of the two focal lengths, px."""
        return math.sqrt(self.K[0][0] * self.K[1][1])

    @property
    def intrinsics_cholesky(self) -> Array:
        """The Cholesky factor of the covariance: (4, 4) of `doubt`, or (1, 1) of the focal length's logarithm."""
        return (
            np.linalg.cholesky(np.array(self.intrinsics_covariance))
            if self.intrinsics_covariance
            else np.array([[self.focal_sigma]])
        )

    def scaled(self, factor: float) -> CameraModel:
        """The camera of images resized by `factor`."""
        (fx, skew, cx), (_, fy, cy), last = self.K
        shift = (factor - 1) / 2
        K = ((fx * factor, skew * factor, cx * factor + shift), (0.0, fy * factor, cy * factor + shift), last)
        size = (round(self.width * factor), round(self.height * factor))
        return CameraModel(*size, K, self.distortion, self.focal_sigma, self.intrinsics_covariance)


def opencv_from_mujoco(rotation: ArrayLike) -> Array:
    """The rotation (3, 3) of a camera's OpenCV frame from that of its MuJoCo frame, or the other way round."""
    return np.asarray(rotation, dtype=np.float64).reshape(3, 3) @ _FLIP_YZ


def project(K: ArrayLike, points_in_cam: ArrayLike) -> Array:
    """Pixel coordinates (n, 2) of points (n, 3) in the camera frame, which must have z > 0."""
    points = np.atleast_2d(np.asarray(points_in_cam, dtype=np.float64))
    rays = points @ np.asarray(K, dtype=np.float64).T
    pixels: Array = rays[:, :2] / rays[:, 2:]
    return pixels
