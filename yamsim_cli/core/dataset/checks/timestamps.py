"""Reads capture times, which converted real recordings have beside their images: `rgb/<camera>/timestamps.npy`."""

from __future__ import annotations

import re

import numpy as np

TIMESTAMPS = "timestamps.npy"

# Version 1.0 of the format, as numpy writes it for a plain list of 64-bit integers. Source: numpy.lib.format.
_MAGIC = b"\x93NUMPY\x01\x00"
_HEADER = re.compile(rb"\{'descr': '([<>])i8', 'fortran_order': (?:True|False), 'shape': \((\d{1,9}),\), \} *\n")


def read_timestamps(data: bytes) -> list[float] | None:
    """Times in s since the first one, from int64 ns; None when it is no such file.

    numpy's own reader is not used: it makes an array as large as the header announces before it looks for the bytes.
    """
    start = len(_MAGIC) + 2
    end = start + int.from_bytes(data[len(_MAGIC) : start], "little")
    header = _HEADER.fullmatch(data[start:end])
    if not data.startswith(_MAGIC) or not header or int(header[2]) * 8 != len(data) - end or end == len(data):
        return None
    times = np.frombuffer(data[end:], f"{header[1].decode()}i8")
    # Subtracted as integers: a float holds nanoseconds since 1970 only to the nearest 0.2 microseconds.
    return [(int(time) - int(times[0])) * 1e-9 for time in times]
