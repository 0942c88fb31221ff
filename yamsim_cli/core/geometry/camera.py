"""Pinhole cameras in OpenCV's convention: x right, y down, z forward; pixel (0, 0) is centred at (0, 0)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .se3 import Array

_FLIP_YZ = np.diag([1.0, -1.0, -1.0])  # to MuJoCo's camera frame, which looks along -z with +y up


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion, px."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_fovy(cls, width: int, height: int, fovy: float) -> Intrinsics:
        """Return the camera of MuJoCo renderings with a vertical field of view `fovy`, rad."""
        focal = height / 2 / math.tan(fovy / 2)
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def K(self) -> Array:
        """Camera matrix (3, 3), px."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_in_cam: ArrayLike) -> Array:
        """Project points (n, 3) in the camera frame, with z > 0, to pixels (n, 2)."""
        return project_points(self.K, points_in_cam)

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the directions (n, 3), with z = 1, in which the camera sees pixels (n, 2)."""
        places = np.atleast_2d(np.asarray(pixels, dtype=np.float64))
        x, y = (places[:, 0] - self.cx) / self.fx, (places[:, 1] - self.cy) / self.fy
        return np.column_stack([x, y, np.ones(len(places))])


@dataclass(frozen=True)
class CameraModel:
    """A calibrated real camera: OpenCV's pinhole model with lens distortion.

    Attributes:
        width, height: px.
        K: camera matrix, row by row, px.
        distortion: in OpenCV's order `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]`; empty for none.
        fisheye: whether `distortion` is `k1 k2 k3 k4` of OpenCV's fisheye model.
        focal_sigma: relative standard deviation of the focal length; a careful calibration gives 0.003.
        intrinsics_covariance: covariance (4, 4), row by row, of estimated intrinsics; empty if only `focal_sigma` is
            given. Order: logarithm of the focal length, principal point (in focal lengths, right and down), `k1`.
    """

    width: int
    height: int
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    distortion: tuple[float, ...] = ()
    focal_sigma: float = 0.003
    intrinsics_covariance: tuple[tuple[float, ...], ...] = ()
    fisheye: bool = False

    @classmethod
    def from_focal_length(cls, width: int, height: int, focal: float, focal_sigma: float = 0.003) -> CameraModel:
        """Return a camera without distortion, with square pixels and the principal point at the image centre."""
        K = ((focal, 0.0, (width - 1) / 2), (0.0, focal, (height - 1) / 2), (0.0, 0.0, 1.0))
        return cls(width, height, K, focal_sigma=focal_sigma)

    @property
    def mean_focal_length(self) -> float:
        """Geometric mean of the two focal lengths, px."""
        return math.sqrt(self.K[0][0] * self.K[1][1])

    @property
    def intrinsics_cholesky(self) -> Array:
        """Cholesky factor (4, 4) of `intrinsics_covariance`; without covariance, `focal_sigma` as (1, 1)."""
        return (
            np.linalg.cholesky(np.array(self.intrinsics_covariance))
            if self.intrinsics_covariance
            else np.array([[self.focal_sigma]])
        )


def opencv_from_mujoco(rotation: ArrayLike) -> Array:
    """Convert a camera rotation (3, 3) from MuJoCo's convention to OpenCV's, or back."""
    return np.asarray(rotation, dtype=np.float64).reshape(3, 3) @ _FLIP_YZ


def project_points(K: ArrayLike, points_in_cam: ArrayLike) -> Array:
    """Project points (n, 3) in the camera frame, with z > 0, to pixel coordinates (n, 2)."""
    points = np.atleast_2d(np.asarray(points_in_cam, dtype=np.float64))
    rays = points @ np.asarray(K, dtype=np.float64).T
    pixels: Array = rays[:, :2] / rays[:, 2:]
    return pixels
