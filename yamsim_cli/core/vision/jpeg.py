"""JPEG in memory: OpenCV's file functions report a full disk by a return value that is easily lost."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import SimulationError

Image = NDArray[np.uint8]


def encode_jpeg(image: Image, quality: int) -> bytes:
    """Encode an RGB image (height, width, 3) with quality 1..100.

    Raises:
        SimulationError: the encoder refused the image.
    """
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise SimulationError(f"an image of shape {image.shape} could not be encoded as JPEG")
    return data.tobytes()


def decode_jpeg(data: bytes) -> Image | None:
    """Decode to RGB (height, width, 3), or None when the data is no whole JPEG.

    Decoders fill in what a cut file lacks with grey, so the end-of-image marker is checked first.
    """
    if not data.startswith(b"\xff\xd8") or not data.endswith(b"\xff\xd9"):
        return None
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        return None
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
