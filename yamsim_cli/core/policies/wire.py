"""Observations and actions as msgpack, with arrays as type, shape and content. Reading them runs no code."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from ..errors import ResourceError
from .bounds import Budget

# The protocol's version, on which both sides have to agree.
PROTOCOL = 1

# msgpack's type number of an array.
_ARRAY = 1
# Kinds of dtypes that can be sent: booleans, whole and floating-point numbers.
_KINDS = "biuf"


class WireError(ValueError):
    """Bytes that are no message of this protocol."""


class UnsendableError(WireError):
    """A policy's answer that cannot be sent; the text says which part of it, and why."""


def require_msgpack() -> None:
    """Make sure that msgpack is installed.

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


def sendable(answer: Any) -> dict[str, Any]:
    """A policy's answer, if it can be sent.

    Raises:
        UnsendableError: it cannot.
    """
    if not isinstance(answer, Mapping):
        raise UnsendableError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    for key, value in answer.items():
        try:
            unpack(pack({key: value}))
        # Other libraries' arrays may raise anything when they are converted, and so may recursion and huge numbers.
        except Exception as error:
            raise UnsendableError(f"{key} of the answer: {error}") from error
    return dict(answer)


def unpack(data: bytes) -> Any:
    """The message in bytes.

    Raises:
        WireError: they are no message, or one with too many values.
    """
    import msgpack

    try:
        budget = Budget()
        return msgpack.unpackb(
            data,
            ext_hook=_unpack_array,
            object_hook=budget.spend,
            list_hook=budget.spend,
            raw=False,
            strict_map_key=True,
        )
    except (ValueError, TypeError, msgpack.exceptions.UnpackException) as error:
        raise WireError(f"not a message: {error}") from error


def _pack_array(value: Any) -> Any:
    import msgpack

    if isinstance(value, np.generic):
        return value.item()
    try:
        # Tensors of any library become arrays by this, except those that are on a GPU or have gradients.
        array = np.asarray(value)
    except Exception as error:
        raise TypeError(f"{type(value).__name__} cannot be sent: {error}") from error
    if array.dtype.kind not in _KINDS:
        what = f"an array of dtype {array.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise TypeError(f"{what} cannot be sent: only numbers, text, plain containers and arrays can")
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
