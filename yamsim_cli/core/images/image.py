"""An image in memory, and what is known of one before it is decoded and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Of colours (height, width, 3), RGB; or grey (height, width).
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class ImageHeader:
    """What an image says of itself before it is decoded."""

    width: int
    height: int
    channels: int


@dataclass(frozen=True)
class ImageLook:
    """What was seen in an image.

    Attributes:
        brightness, contrast: mean and standard deviation of a smaller grey version, 0..255.
        fingerprint: equal for equal pictures.
        complaint: what the decoder had to make up; "" for a whole image.
    """

    brightness: float
    contrast: float
    fingerprint: int
    complaint: str = ""
