from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# RGB (height, width, 3), or grey (height, width).
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class ImageHeader:
    """Size (px) and number of colour channels of an image, as its file header states them."""

    width: int
    height: int
    channels: int


@dataclass(frozen=True)
class ImageStats:
    """Statistics of a decoded image.

    Attributes:
        brightness, contrast: mean and standard deviation of the reduced grey image, 0..255.
        fingerprint: checksum of the grey pixels.
        decoder_warning: first line of the decoder's message; "" for an undamaged image.
    """

    brightness: float
    contrast: float
    fingerprint: int
    decoder_warning: str = ""
