"""Blur from defocus and from camera motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.float32]

_POINTS_PER_PX, _MIN_POINTS = 4, 9  # sample points per px of a motion, and their minimum
_BLUR_DIFFERENCE_STEP = 0.03  # step of the numeric derivative, as a share of the blur
# Two pixels on each side: with one, derivatives of a sharp picture would be a third too small.
_DERIVATIVE_KERNEL = np.array([1, -8, 0, 8, -1], np.float32) / 12
_IDENTITY_KERNEL = np.ones(1, np.float32)
_BORDER_MODE = cv2.BORDER_REPLICATE


@dataclass(frozen=True)
class BlurKernel:
    """Defocus `blur` (sigma of a Gaussian) and uniform `motion` (right, down) of a picture, px.

    Opposite motions are equivalent.
    """

    blur: float
    motion: tuple[float, float] = (0.0, 0.0)

    @property
    def motion_length(self) -> float:
        """Length of the motion, px."""
        return math.hypot(*self.motion)

    @property
    def blur_radius(self) -> float:
        """Radius (px) that contains most of a blurred point."""
        return 1.2 * math.sqrt(self.blur**2 + self.motion_length**2 / 12)

    def scaled_to_reduced_picture(self, coarser: int) -> BlurKernel:
        """Convert to pixels of a picture reduced by the factor `coarser`."""
        return BlurKernel(self.blur / coarser, (self.motion[0] / coarser, self.motion[1] / coarser))

    def blur_picture(self, picture: Grey) -> Grey:
        """Blur a picture (rows, columns[, channels])."""
        blurred = cv2.GaussianBlur(picture, (0, 0), self.blur, borderType=_BORDER_MODE)
        if self.motion_length:
            blurred = cv2.filter2D(blurred, -1, self._motion_kernel(slope=False), borderType=_BORDER_MODE)
        return np.asarray(blurred, dtype=np.float32)

    def motion_derivatives(self, picture: Grey) -> tuple[Grey, Grey]:
        """Return the blurred picture's derivatives (rows, columns) by motion right and down."""
        blurred = cv2.GaussianBlur(picture, (0, 0), self.blur, borderType=_BORDER_MODE)
        line = self._motion_kernel(slope=True)
        across, down = (
            np.asarray(cv2.filter2D(slope, -1, line, borderType=_BORDER_MODE), dtype=np.float32)
            for slope in picture_gradients(np.asarray(blurred, dtype=np.float32))
        )
        return across, down

    def blur_derivative(self, picture: Grey, blurred: Grey) -> Grey:
        """Return the derivative (rows, columns[, channels]) of `blurred` by the blur sigma."""
        more = _BLUR_DIFFERENCE_STEP * self.blur
        by_blur: Grey = (BlurKernel(self.blur + more, self.motion).blur_picture(picture) - blurred) / np.float32(more)
        return by_blur

    def _motion_kernel(self, slope: bool) -> Grey:
        """Return the motion's kernel (k, k); `slope` weights points by their position along it."""
        x, y = self.motion
        side = math.ceil(self.motion_length / 2 + 1)
        kernel = np.zeros((2 * side + 1, 2 * side + 1), np.float32)
        along = np.linspace(-0.5, 0.5, max(_MIN_POINTS, math.ceil(self.motion_length * _POINTS_PER_PX)) + 1)
        # The first and last points cover half a step.
        weight = np.full(len(along), 1.0)
        weight[[0, -1]] = 0.5
        weight /= weight.sum()
        # `filter2D` correlates: for a motion by +s, a pixel gets the value at -s.
        values = weight * along if slope else weight
        column, row = np.floor(side - along * x).astype(int), np.floor(side - along * y).astype(int)
        right, below = side - along * x - column, side - along * y - row
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            share = np.abs(1 - dx - right) * np.abs(1 - dy - below)
            np.add.at(kernel, (row + dy, column + dx), values * share)
        # The sample at -s changes by minus the slope there.
        return -kernel if slope else kernel


def picture_gradients(picture: Grey) -> tuple[Grey, Grey]:
    """Return derivatives (rows, columns) to the right and down, per px."""
    across = cv2.sepFilter2D(picture, cv2.CV_32F, _DERIVATIVE_KERNEL, _IDENTITY_KERNEL, borderType=_BORDER_MODE)
    down = cv2.sepFilter2D(picture, cv2.CV_32F, _IDENTITY_KERNEL, _DERIVATIVE_KERNEL, borderType=_BORDER_MODE)
    return np.asarray(across, dtype=np.float32), np.asarray(down, dtype=np.float32)
