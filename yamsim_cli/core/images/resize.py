from __future__ import annotations

import cv2
import numpy as np

from .image import Image


def resize_image(image: Image, size: tuple[int, int], *, pad: bool) -> Image:
    """Return an image (height, width, 3) scaled to `size` (width, height), px; `pad` adds black borders instead of
    stretching.
    """
    height, width = image.shape[:2]
    if (width, height) == size:
        return image
    ratio = min(size[0] / width, size[1] / height)
    inner = (max(1, round(width * ratio)), max(1, round(height * ratio))) if pad else size
    # Averaging over areas keeps thin objects visible when an image shrinks.
    how = cv2.INTER_AREA if inner[0] < width or inner[1] < height else cv2.INTER_LINEAR
    scaled = np.asarray(cv2.resize(image, inner, interpolation=how), dtype=np.uint8)
    if inner == size:
        return scaled
    whole = np.zeros((size[1], size[0], 3), np.uint8)
    left, top = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    whole[top : top + inner[1], left : left + inner[0]] = scaled
    return whole
