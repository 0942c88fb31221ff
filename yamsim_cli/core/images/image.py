"""Images in memory, and measures of an image before and after decoding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# RGB (height, width, 3), or grey (height, width).
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class ImageHeader:
    """An image's size and number of channels, from the file's header."""

    width: int
    height: int
    channels: int


@dataclass(frozen=True)
class ImageStats:
    """Measures of a decoded image.

    Attributes:
        brightness, contrast: mean and standard deviation of a smaller grey version, 0..255.
        fingerprint: a number that is equal for equal pictures.
        decoder_warning: the decoder's message; "" for a whole image.
    """

    brightness: float
    contrast: float
    fingerprint: int
    decoder_warning: str = ""
