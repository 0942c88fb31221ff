"""Capture times beside a camera's images, as converted real recordings have them: `rgb/<camera>/timestamps.npy`."""

from __future__ import annotations

import io
import math

import numpy as np
from numpy.lib import format as npy

TIMESTAMPS = "timestamps.npy"


def read_timestamps(data: bytes) -> list[float] | None:
    """Times in s from int64 ns, the first one 0; None when it is no such file.

    The header is not trusted: numpy's own reader would make an array as large as the header says.
    """
    stream = io.BytesIO(data)
    try:
        version = npy.read_magic(stream)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read(stream)
    except (ValueError, EOFError, TypeError, SyntaxError, RecursionError, MemoryError):
        return None
    raw = data[stream.tell() :]
    if dtype.kind not in "iu" or len(shape) != 1 or math.prod(shape) * dtype.itemsize != len(raw) or not shape[0]:
        return None
    times = np.frombuffer(raw, dtype)
    # Subtracted as integers: a float holds nanoseconds since 1970 only to the nearest 0.2 microseconds.
    return [(int(time) - int(times[0])) * 1e-9 for time in times]
