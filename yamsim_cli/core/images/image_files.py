from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import ResourceError
from .image import Image
from .png import is_complete_png

Mask = NDArray[np.bool_]

_MAX_BYTES = 200_000_000  # bytes; photos of all cameras are smaller


def read_image(path: Path) -> Image:
    """Read a PNG or JPEG file as an RGB image (height, width, 3), upright by its EXIF data.

    An unreadable or incomplete file, or one over 200 MB, raises ResourceError.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ResourceError(f"{path} is larger than {_MAX_BYTES // 1_000_000} MB; scale it down")
        data = path.read_bytes()
    except OSError as error:
        raise ResourceError(f"{path} cannot be read: {error.strerror or error}") from error
    image = decode_image(data)
    if image is None:
        raise ResourceError(f"{path} is not a valid PNG or JPEG; export it again")
    return image


def decode_image(data: bytes) -> Image | None:
    """Decode a PNG or JPEG to an RGB image (height, width, 3), upright by its EXIF data; None for damaged data."""
    if not _is_complete(data):
        return None
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if image is None else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_mask(path: Path) -> Mask:
    """Read a mask (height, width): True where a PNG is not 0, or where a JPEG, which blurs edges, is above 127.

    Raises as `read_image`.
    """
    lossy = path.suffix.lower() != ".png"
    inside: Mask = read_image(path).max(axis=2) > (127 if lossy else 0)
    return inside


def to_grey(image: Image) -> Image:
    """Return the grey image (height, width) of an RGB image (height, width, 3)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _is_complete(data: bytes) -> bool:
    """Return whether an image file is complete. Decoders fill missing parts with grey."""
    if data.startswith(b"\xff\xd8"):
        # Cameras append previews and metadata after the end marker.
        return data.rfind(b"\xff\xd9") > len(data) // 2
    return is_complete_png(data)
