"""JPEG in memory. OpenCV's functions for files are not used: they report a full disk only by a return value."""

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

# Brightness and contrast are measured on a reduced image, in which noise is averaged away.
_MOST_REDUCTION = 8
_SMALL_SIDE = 16  # px that the short side keeps

_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
# Start-of-frame markers, C0 to CF without those that define tables (C4, CC) and the reserved C8.
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def encode_jpeg(image: Image, quality: int) -> bytes:
    """The JPEG of an RGB image (height, width, 3), with a quality of 1..100.

    Raises:
        SimulationError: the encoder refused the image.
    """
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise SimulationError(f"an image of shape {image.shape} could not be encoded as JPEG")
    return data.tobytes()


def decode_jpeg(data: bytes) -> Image | None:
    """The RGB image (height, width, 3) in a JPEG; None if the data is no whole JPEG."""
    # Decoders would fill in the missing part of a cut file with grey.
    if not data.startswith(_SOI) or not data.endswith(_EOI):
        return None
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        return None
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def jpeg_header(data: bytes) -> ImageHeader | None:
    """Size and channels from the header alone; None when the data is no JPEG, or lacks its end.

    Source: ITU-T T.81, B.1.1.4 and B.2.2: marker segments, and the frame header's fields.
    """
    # Some cameras fill up with zeros behind the end.
    if not data.startswith(_SOI) or not data.rstrip(b"\0").endswith(_EOI):
        return None
    position = 2
    while position + 9 < len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker in _FRAME_MARKERS:
            height, width = (int.from_bytes(data[position + k : position + k + 2], "big") for k in (5, 7))
            return ImageHeader(width, height, data[position + 9]) if width and height else None
        # A marker may be preceded by any number of fill bytes.
        position += 1 if marker == 0xFF else 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return None


class JpegReader:
    """Measures JPEGs; as a context manager, the reader also catches the decoder's complaints.

    libjpeg decodes damaged JPEGs too, and complains only on the process's stderr. So stderr is a file while the context
    is open, for the whole process: use the reader in a separate process.
    """

    def __init__(self) -> None:
        self._messages: IO[bytes] | None = None
        self._stderr = -1

    def header(self, data: bytes) -> ImageHeader | None:
        """See `jpeg_header`."""
        return jpeg_header(data)

    def measure(self, data: bytes) -> ImageStats | None:
        """Measures of the image; None if it cannot be decoded."""
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        grey = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        complaint = self._complaint()
        if grey is None:
            return None
        reduction = max(1, min(_MOST_REDUCTION, min(grey.shape) // _SMALL_SIDE))
        size = (max(1, grey.shape[1] // reduction), max(1, grey.shape[0] // reduction))
        small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        mean, deviation = cv2.meanStdDev(small)
        return ImageStats(float(mean[0, 0]), float(deviation[0, 0]), zlib.crc32(grey.tobytes()), complaint)

    def labels(self, data: bytes) -> Image | None:
        """See `decode_labels`."""
        return decode_labels(data)

    def _complaint(self) -> str:
        # Both descriptors share one position in the file, which has moved if the decoder has written.
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
    """A JPEG of at most `width` pixels across; None if the data cannot be decoded."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_COLOR_2)
    if image is None:
        return None
    if image.shape[1] > width:
        height = max(1, round(image.shape[0] * width / image.shape[1]))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return encode_jpeg(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8), quality)
