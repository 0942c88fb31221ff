"""JPEG data in memory. OpenCV's file functions report a full disk only by a return value, so they are not used."""

from __future__ import annotations

import os
import tempfile
import zlib
from types import TracebackType
from typing import IO

import cv2
import numpy as np

from ..errors import SimulationError
from .image import Image, ImageHeader, ImageStats
from .png import decode_labels

# Brightness and contrast are measured in a reduced image, where noise is averaged away.
_MAX_REDUCTION = 8  # by which width and height are divided
_MIN_SIDE = 16  # px, after the reduction

_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
# C0 to CF without the table definitions (C4, CC) and the reserved C8.
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def encode_jpeg(image: Image, quality: int) -> bytes:
    """Encode an RGB image (height, width, 3) as JPEG with a quality of 1..100; raise SimulationError on failure."""
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise SimulationError(f"an image of shape {image.shape} could not be encoded as JPEG")
    return data.tobytes()


def decode_jpeg(data: bytes) -> Image | None:
    """Decode a JPEG to an RGB image (height, width, 3); None if the data is not a complete JPEG."""
    # Decoders fill the missing part of a truncated file with grey.
    if not data.startswith(_SOI) or not data.endswith(_EOI):
        return None
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        return None
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def jpeg_header(data: bytes) -> ImageHeader | None:
    """Return size and number of channels from the header alone; None for a truncated JPEG or other data.

    Source: ITU-T T.81, B.1.1.4 (marker segments) and B.2.2 (fields of the frame header).
    """
    # Some cameras append zeros to the end marker.
    if not data.startswith(_SOI) or not data.rstrip(b"\0").endswith(_EOI):
        return None
    position = 2
    while position + 9 < len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker in _FRAME_MARKERS:
            height, width = (int.from_bytes(data[position + k : position + k + 2], "big") for k in (5, 7))
            return ImageHeader(width, height, data[position + 9]) if width and height else None
        # Any number of fill bytes may precede a marker.
        position += 1 if marker == 0xFF else 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return None


class JpegReader:
    """Computes statistics of JPEGs. As a context manager, the reader also captures the decoder's warnings.

    libjpeg writes its warnings only to stderr. While the context is open, the stderr of the whole process is therefore
    a temporary file. Use the reader in a separate process.
    """

    def __init__(self) -> None:
        self._messages: IO[bytes] | None = None
        self._stderr = -1

    def header(self, data: bytes) -> ImageHeader | None:
        """See `jpeg_header`."""
        return jpeg_header(data)

    def compute_stats(self, data: bytes) -> ImageStats | None:
        """Return statistics of a JPEG; None if it cannot be decoded."""
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        grey = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        warning = self._take_warning()
        if grey is None:
            return None
        reduction = max(1, min(_MAX_REDUCTION, min(grey.shape) // _MIN_SIDE))
        size = (max(1, grey.shape[1] // reduction), max(1, grey.shape[0] // reduction))
        small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        mean, deviation = cv2.meanStdDev(small)
        return ImageStats(float(mean[0, 0]), float(deviation[0, 0]), zlib.crc32(grey.tobytes()), warning)

    def read_labels(self, data: bytes) -> Image | None:
        """See `decode_labels`."""
        return decode_labels(data)

    def _take_warning(self) -> str:
        # Descriptor 2 (stderr) and `_messages` share a file position, which has advanced if the decoder has written.
        if self._messages is None or not self._messages.tell():
            return ""
        self._messages.seek(0)
        text = self._messages.read().decode(errors="replace").strip()
        self._messages.seek(0)
        self._messages.truncate()
        return text.splitlines()[0] if text else ""

    def __enter__(self) -> JpegReader:
        self._stderr = os.dup(2)
        self._messages = tempfile.TemporaryFile(buffering=0)
        os.dup2(self._messages.fileno(), 2)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.dup2(self._stderr, 2)
        os.close(self._stderr)
        if self._messages is not None:
            self._messages.close()
            self._messages = None


def thumbnail(data: bytes, width: int, quality: int = 80) -> bytes | None:
    """Return a JPEG of the image with a width of at most `width` px; None if the data cannot be decoded."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_COLOR_2)
    if image is None:
        return None
    if image.shape[1] > width:
        height = max(1, round(image.shape[0] * width / image.shape[1]))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return encode_jpeg(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8), quality)
