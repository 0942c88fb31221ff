"""PNG in memory."""

from __future__ import annotations

import struct
import zlib

import cv2

from .image import Image


def encode_png(image: Image, px_per_metre: float | None = None) -> bytes:
    """Encode a grey image (height, width), or one of RGB (height, width, 3), as PNG.

    Args:
        image: what to encode.
        px_per_metre: how large it prints. PNG holds a whole number, so at 600 dpi a print is 0.003 % off at most.

    Raises:
        ValueError: the encoder refused the image.
    """
    data = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    done, encoded = cv2.imencode(".png", data)
    if not done:
        raise ValueError(f"an image of shape {image.shape} could not be encoded as PNG")
    png = encoded.tobytes()
    return png if px_per_metre is None else _with_scale(png, round(px_per_metre))


# A PNG begins with its signature (8 bytes) and the chunk IHDR (length 4, name 4, data 13, checksum 4).
_AFTER_HEADER = 8 + 25
_UNIT_METRE = 1


def _with_scale(png: bytes, px_per_metre: int) -> bytes:
    """Add the chunk `pHYs`, which OpenCV does not write, to a PNG. Source: PNG specification, 11.3.4.3."""
    body = b"pHYs" + struct.pack(">IIB", px_per_metre, px_per_metre, _UNIT_METRE)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:_AFTER_HEADER] + chunk + png[_AFTER_HEADER:]
