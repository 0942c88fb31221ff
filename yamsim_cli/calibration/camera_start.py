"""What is known of a camera's lens before a fit, and its distortion after one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..core.geometry.camera import CameraModel

_FOCAL_SIGMA = 0.4  # of the logarithm of an unknown focal length
_LENS_SIGMA = 0.05  # of an unknown distortion's k1; lenses of 60 to 100 degrees have up to 0.1
_MAX_K1 = 4 * _LENS_SIGMA  # largest k1 to remove: a first fit to a wrong pose may give more
# Largest -k1 to remove, times the square of the distance of the farthest corner from the axis over the focal length.
# A distorted lens reaches a corner if this is less than 4 / 27.
_MAX_BARREL = 0.9 * 4 / 27
# Powers of the focal length's factor with which OpenCV's coefficients change, so that the lens stays the same: k1, k2,
# p1, p2, k3 to k6, s1 to s4. The tilt of the sensor, tx and ty, is kept.
_POWERS = (2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3, 0, 0)


@dataclass(frozen=True)
class CameraPrior:
    """What is known of a camera before the fit.

    Attributes:
        focal: standard deviation of the logarithm of the focal length.
        lens: standard deviation of the distortion k1 about 0. A known distortion has 0.
        removed_k1: estimated k1, for the focal length before the fit, that was removed from the pictures. A known
            distortion does not count.
    """

    focal: float
    lens: float = 0.0
    removed_k1: float = 0.0


@dataclass(frozen=True)
class CameraStart:
    """The intrinsics of a camera with which a fit starts.

    Attributes:
        is_focal_known: whether `model` has the given or recorded focal length, not a guess.
        is_lens_known: whether the distortion was given. If not, the fit estimates k1.
    """

    model: CameraModel
    is_focal_known: bool
    is_lens_known: bool

    @property
    def prior(self) -> CameraPrior:
        """What is known before the fit."""
        focal = self.model.focal_sigma if self.is_focal_known else _FOCAL_SIGMA
        return CameraPrior(focal) if self.is_lens_known else CameraPrior(focal, _LENS_SIGMA, self.k1)

    @property
    def k1(self) -> float:
        """First coefficient of the distortion."""
        return self.model.distortion[0] if self.model.distortion else 0.0

    def with_removed_k1(self, remaining: float, log_focal: float) -> CameraStart:
        """Return the start of another fit, from whose pictures the distortion that a fit found is removed.

        Args:
            remaining: k1 that the fit found in the undistorted pictures, for its focal length.
            log_focal: logarithm of the fitted focal length over that of `model`. `k1` belongs to the latter.
        """
        K = np.array(self.model.K)
        corner = np.maximum(K[:2, 2], np.subtract((self.model.width, self.model.height), K[:2, 2])) / np.diag(K)[:2]
        lowest = max(-_MAX_K1, -_MAX_BARREL / float(corner @ corner))
        k1 = float(np.clip(self.k1 + remaining / math.exp(2 * log_focal), lowest, _MAX_K1))
        return replace(self, model=replace(self.model, distortion=(k1, 0.0, 0.0, 0.0)))

    def fitted_model(self, remaining: float, log_focal: float) -> CameraModel:
        """Return the camera with the focal length and the distortion of a fit.

        Also a given distortion changes with the focal length, because its coefficients belong to the given one.

        Args:
            remaining: k1 that the fit found in the undistorted pictures, for its focal length, unless it was given.
            log_focal: logarithm of the fitted focal length over that of `model`.
        """
        scale, ((fx, _, cx), (_, fy, cy), last) = math.exp(log_focal), self.model.K
        K = (fx * scale, 0.0, cx), (0.0, fy * scale, cy), last
        if self.is_lens_known:
            given = self.model.distortion
            coefficients = tuple(value * scale**power for value, power in zip(given, _POWERS, strict=False))
        else:
            coefficients = fitted_k1(self.k1, remaining, log_focal), 0.0, 0.0, 0.0
        return replace(self.model, K=K, distortion=coefficients)


def fitted_k1(removed: float, remaining: float, log_focal: float) -> float:
    """Return k1 for the fitted focal length: what was removed from the pictures, and what remained in them."""
    return removed * math.exp(2 * log_focal) + remaining
