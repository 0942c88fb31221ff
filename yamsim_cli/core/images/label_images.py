"""Segmentation images as PNG of one channel, with a label for each pixel."""

from __future__ import annotations

import struct

import cv2
import numpy as np

from ..errors import SimulationError
from .image import Image
from .image_files import whole_png

# Labels come in runs of equal numbers: run-length encoding is the fastest, and the second smallest. Source: measured
# with OpenCV 5.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
# Images with more pixels are not decoded: a header can announce gigabytes. No camera here comes near.
_MOST_PIXELS = 2**26
# Width, height, bits per sample and colour type (0 for grey) in the first chunk, and their offset in the file. Source:
# PNG specification, 11.2.2.
_HEADER = struct.Struct(">IIBB")
_AT = 16


def encode_labels(labels: Image) -> bytes:
    """A segmentation image (height, width) as a PNG of one channel.

    Raises:
        SimulationError: the encoder refused the image.
    """
    done, data = cv2.imencode(".png", labels, _PNG)
    if not done:
        raise SimulationError(f"a segmentation image of shape {labels.shape} could not be encoded as PNG")
    return data.tobytes()


def decode_labels(data: bytes) -> Image | None:
    """A segmentation image (height, width) of uint8 from its PNG; None if it is none, or not whole."""
    if not whole_png(data) or len(data) < _AT + _HEADER.size:
        return None
    width, height, bits, colour = _HEADER.unpack_from(data, _AT)
    if not 0 < width * height <= _MOST_PIXELS or (bits, colour) != (8, 0):
        return None
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, np.uint8)
