"""What a lens out of focus and a camera that moves do to a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.float32]

# A straight smear is laid down as so many points a pixel of its length, and at least this many.
_POINTS_A_PX, _LEAST_POINTS = 4, 9

# By how much more blur (a share) it is told how pictures change with it.
_A_LITTLE = 0.03

# Slopes from two pixels to either side: with the next ones alone, those of a sharp picture would come out a third flat.
_SLOPE = np.array([1, -8, 0, 8, -1], np.float32) / 12
_AS_IT_IS = np.ones(1, np.float32)

# What is beyond the picture's edge: what is at the edge goes on.
_BEYOND = cv2.BORDER_REPLICATE


@dataclass(frozen=True)
class Smear:
    """How a picture is smeared.

    Attributes:
        blur: sigma of the lens' blur, px.
        motion: how far (right, down; px) the picture moved evenly while it was taken; either sign is the same.
    """

    blur: float
    motion: tuple[float, float] = (0.0, 0.0)

    @property
    def length(self) -> float:
        """Of the motion, px."""
        return math.hypot(*self.motion)

    @property
    def reach(self) -> float:
        """How far (px) most of a point is smeared: three standard deviations of it, over two."""
        return 1.2 * math.sqrt(self.blur**2 + self.length**2 / 12)

    def in_larger_pixels(self, coarser: int) -> Smear:
        """The same in a picture of larger pixels."""
        return Smear(self.blur / coarser, (self.motion[0] / coarser, self.motion[1] / coarser))

    def of(self, picture: Grey) -> Grey:
        """A picture (rows, columns[, channels]), smeared."""
        blurred = cv2.GaussianBlur(picture, (0, 0), self.blur, borderType=_BEYOND)
        if self.length:
            blurred = cv2.filter2D(blurred, -1, self._line(slope=False), borderType=_BEYOND)
        return np.asarray(blurred, dtype=np.float32)

    def by_motion(self, picture: Grey) -> tuple[Grey, Grey]:
        """How the smeared picture (rows, columns) changes with the motion, right and down."""
        blurred = cv2.GaussianBlur(picture, (0, 0), self.blur, borderType=_BEYOND)
        line = self._line(slope=True)
        across, down = (
            np.asarray(cv2.filter2D(slope, -1, line, borderType=_BEYOND), dtype=np.float32)
            for slope in slopes_of(np.asarray(blurred, dtype=np.float32))
        )
        return across, down

    def by_blur(self, picture: Grey, smeared: Grey) -> Grey:
        """How the smeared picture (rows, columns[, channels]) changes with the blur."""
        more = _A_LITTLE * self.blur
        by_blur: Grey = (Smear(self.blur + more, self.motion).of(picture) - smeared) / np.float32(more)
        return by_blur

    def _line(self, slope: bool) -> Grey:
        """The weights (k, k) of a straight smear; or, by the `slope`, of how far along it each point is."""
        x, y = self.motion
        side = math.ceil(self.length / 2 + 1)
        kernel = np.zeros((2 * side + 1, 2 * side + 1), np.float32)
        along = np.linspace(-0.5, 0.5, max(_LEAST_POINTS, math.ceil(self.length * _POINTS_A_PX)) + 1)
        # The first and the last point stand for half a step only.
        weight = np.full(len(along), 1.0)
        weight[[0, -1]] = 0.5
        weight /= weight.sum()
        # `filter2D` correlates: a picture that moves by +s is looked up at -s.
        values = weight * along if slope else weight
        column, row = np.floor(side - along * x).astype(int), np.floor(side - along * y).astype(int)
        right, below = side - along * x - column, side - along * y - row
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            share = np.abs(1 - dx - right) * np.abs(1 - dy - below)
            np.add.at(kernel, (row + dy, column + dx), values * share)
        # The derivative by the motion of what is looked up at -s is minus the slope there.
        return -kernel if slope else kernel


def slopes_of(picture: Grey) -> tuple[Grey, Grey]:
    """Slopes of a picture (rows, columns), right and down, per px."""
    across = cv2.sepFilter2D(picture, cv2.CV_32F, _SLOPE, _AS_IT_IS, borderType=_BEYOND)
    down = cv2.sepFilter2D(picture, cv2.CV_32F, _AS_IT_IS, _SLOPE, borderType=_BEYOND)
    return np.asarray(across, dtype=np.float32), np.asarray(down, dtype=np.float32)
