"""Converts RGB images to the planes that H.264 stores, by either of the two matrices in use."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .image import Image


@dataclass(frozen=True)
class Matrix:
    """A conversion of RGB to luma and two colour differences, in limited range.

    Attributes:
        red, blue: their shares of luma; green has the rest.
        tag: the matrix's number in a stream. Source: ITU-T H.273, table 4.
    """

    red: float
    blue: float
    tag: int


# The matrix that players assume for an untagged H.264 stream. Source: ITU-R BT.709, 3.2.
BT709 = Matrix(0.2126, 0.0722, 1)
# The matrix that decoders for training assume if they ignore the tag. Source: ITU-R BT.601, 2.5.1.
BT601 = Matrix(0.299, 0.114, 6)

# Y, Cb and Cr of black, and the ranges of luma and colours. Source: ITU-R BT.709, 3.4 and 3.5; BT.601 has the same.
_OFFSET = np.array([16.0, 128.0, 128.0])
_LUMA_RANGE, _COLOUR_RANGE = 219, 224


def yuv420(image: Image, matrix: Matrix) -> NDArray[np.uint8]:
    """The planes Y, Cb and Cr of an RGB image, (3 / 2 height, width); an odd side gets its last row or column twice.

    FFmpeg's own conversion is not used: its result depends on how the memory happens to be aligned.
    """
    height, width = image.shape[:2]
    # Colours have half the resolution in both directions, so both sides have to be even.
    even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    full = cv2.transform(even.astype(np.float32), np.column_stack([_rows(matrix) / 255, _OFFSET]))
    half = cv2.resize(full, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA)
    planes = [full[..., 0].ravel(), half[..., 1].ravel(), half[..., 2].ravel()]
    rounded: NDArray[np.uint8] = np.round(np.concatenate(planes)).astype(np.uint8).reshape(-1, even.shape[1])
    return rounded


def _rows(matrix: Matrix) -> NDArray[np.float64]:
    """The matrix (3, 3) from RGB in 0..1 to Y, Cb and Cr."""
    luma = np.array([matrix.red, 1 - matrix.red - matrix.blue, matrix.blue])
    return np.array(
        [
            _LUMA_RANGE * luma,
            _COLOUR_RANGE / 2 * (np.array([0, 0, 1]) - luma) / (1 - matrix.blue),
            _COLOUR_RANGE / 2 * (np.array([1, 0, 0]) - luma) / (1 - matrix.red),
        ]
    )
