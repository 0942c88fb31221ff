"""PNG in memory."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np

from .image import Image


def encode_png(image: Image, px_per_metre: float | None = None) -> bytes:
    """The PNG of a grey image (height, width) or an RGB one (height, width, 3).

    Args:
        px_per_metre: resolution for printing. PNG holds a whole number: at 600 dpi, that is off by 0.003 % at most.

    Raises:
        ValueError: the encoder refused the image.
    """
    data = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    done, encoded = cv2.imencode(".png", data)
    if not done:
        raise ValueError(f"an image of shape {image.shape} could not be encoded as PNG")
    png = encoded.tobytes()
    return png if px_per_metre is None else _with_scale(png, round(px_per_metre))


def decode_png(data: bytes) -> Image | None:
    """The RGB image (height, width, 3) of a PNG; None if it is none."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if image is None else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


# A PNG begins with its signature (8 bytes) and the chunk IHDR (length 4, name 4, data 13, checksum 4).
_AFTER_HEADER = 8 + 25
_UNIT_METRE = 1


def _with_scale(png: bytes, px_per_metre: int) -> bytes:
    """The PNG with the chunk `pHYs`, which OpenCV does not write. Source: PNG specification, 11.3.4.3."""
    body = b"pHYs" + struct.pack(">IIB", px_per_metre, px_per_metre, _UNIT_METRE)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:_AFTER_HEADER] + chunk + png[_AFTER_HEADER:]
