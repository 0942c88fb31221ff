"""Observations and actions as bytes: msgpack, with arrays as type, shape and content. Reading runs nothing."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from ..errors import ResourceError

# The protocol's version, which both sides tell.
PROTOCOL = 1

_ARRAY = 1
# Booleans, whole and floating-point numbers.
_KINDS = "biuf"


class WireError(ValueError):
    """Bytes that are no message of this protocol."""


def require_msgpack() -> None:
    """Make sure that messages can be written here.

    Raises:
        ResourceError: msgpack is not installed.
    """
    try:
        import msgpack  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "msgpack":
            raise
        raise ResourceError(
            "a policy in another process needs msgpack, which is not here: pip install 'yamsim[remote]'"
        ) from error


def pack(message: Any) -> bytes:
    """A message as bytes: plain containers, text, numbers and numpy arrays of numbers."""
    import msgpack

    return cast("bytes", msgpack.packb(message, default=_pack_array, use_bin_type=True))


def unpack(data: bytes) -> Any:
    """A message back from bytes.

    Raises:
        WireError: it is none.
    """
    import msgpack

    try:
        return msgpack.unpackb(data, ext_hook=_unpack_array, raw=False, strict_map_key=True)
    except (ValueError, TypeError, msgpack.exceptions.UnpackException) as error:
        raise WireError(f"not a message: {error}") from error


def _pack_array(value: Any) -> Any:
    import msgpack

    if isinstance(value, np.generic):
        return value.item()
    # Tensors of any kind become arrays by themselves.
    array = np.asarray(value)
    if array.dtype.kind not in _KINDS:
        raise TypeError(f"{type(value).__name__} cannot be sent: only numbers, text, plain containers and arrays can")
    content = np.ascontiguousarray(array).tobytes()
    return msgpack.ExtType(_ARRAY, msgpack.packb([array.dtype.str, list(array.shape), content]))


def _unpack_array(code: int, data: bytes) -> Any:
    import msgpack

    if code != _ARRAY:
        raise WireError(f"unknown type {code}")
    kind, shape, content = msgpack.unpackb(data)
    dtype = np.dtype(str(kind))
    if dtype.kind not in _KINDS or math.prod(shape) * dtype.itemsize != len(content):
        raise WireError(f"{len(content)} bytes are no array of {dtype} {shape}")
    return np.frombuffer(content, dtype).reshape(shape).copy()
