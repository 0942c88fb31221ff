"""Photos embedded in scene configs as text, so that a dataset's config contains all that its images need."""

from __future__ import annotations

import base64
import binascii
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from ..core.files.documents.config_base import Config, Name

_MAX_CHARACTERS = 8_000_000  # of a photo's text: JPEGs of up to 6 MB, as 12-megapixel cameras write


def decode_photo(text: str) -> NDArray[np.uint8]:
    """Return the RGB image (height, width, 3) of a photo's text. Raise ValueError if it holds no JPEG or PNG."""
    import cv2  # takes 0.1 s to load, and most scenes have no photos

    try:
        data = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except binascii.Error:
        data = np.empty(0, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise ValueError("is not a JPEG or PNG as base64 text; let `yamsim match` write it")
    return np.ascontiguousarray(image[..., ::-1], np.uint8)


def photo_text(jpeg: bytes) -> str:
    """Return the text of a photo from its JPEG data."""
    return base64.b64encode(jpeg).decode("ascii")


def _require_photo(text: str) -> str:
    decode_photo(text)
    return text


PhotoText = Annotated[str, Field(max_length=_MAX_CHARACTERS), AfterValidator(_require_photo)]


class Plate(Config):
    """A photo that a fixed camera shows in place of table, floor, walls and sky. Arms and objects occlude it.

    Attributes:
        camera: name of the camera, which the photo must show without distortion: the same pose, the same vertical field
            of view, and the principal point in the middle.
        photo: JPEG or PNG as base64 text. It is scaled to the size of the images.
    """

    camera: Name
    photo: PhotoText
