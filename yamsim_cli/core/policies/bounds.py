"""Limits of a policy server's answer: its bytes, its values, and its actions. Nothing in an answer is run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..geometry.se3 import Array
from .base import LONGEST, MOST_ACTIONS, SHORTEST, InvalidActionError

# Bytes of the largest answer that is read. A thousand actions of two arms take 0.15 MB as JSON.
LARGEST = 4_000_000

MOST_VALUES = 100_000  # Values and containers in a message: seven times 1000 actions of two arms as plain numbers.
LONGEST_TEXT = 2_000  # Characters of an error text that are kept: one is kept for each trial.
LONGEST_TRACEBACK = 50_000  # Characters of a traceback that are kept, of its end.

_MOST_AXES = 8
# Kinds of dtypes: booleans, whole and floating-point numbers, of at most eight bytes.
_KINDS, _WIDEST = "biuf", 8


class DamagedError(ValueError):
    """An answer that is no message of the protocol; the text says what is wrong."""


class Budget:
    """Counts the values of one message while it is decoded, as the hooks of msgpack.

    Small containers take far more memory decoded than encoded, so they are counted before the message is complete.
    """

    def __init__(self) -> None:
        self._left = MOST_VALUES

    def spend(self, found: Any) -> Any:
        """The container itself, after its values were counted.

        Raises:
            DamagedError: the message has more values than may be decoded.
        """
        self._left -= 1 + len(found)
        if self._left < 0:
            raise DamagedError(f"it holds more than {MOST_VALUES} values")
        return found


def check_json(data: bytes) -> None:
    """Check how many values JSON text can hold at most, before it is decoded.

    Raises:
        DamagedError: it may hold more than are decoded.
    """
    if sum(data.count(mark) for mark in (b",", b"[", b"{")) > MOST_VALUES:
        raise DamagedError(f"it holds more than {MOST_VALUES} values")


def plain_numbers(value: object, key: str) -> np.ndarray:
    """A server's numbers as an array. Text is refused first: an array of it is as wide as its longest text.

    Raises:
        InvalidActionError: they are no array of numbers, or their rows differ in length.
    """
    if not isinstance(value, np.ndarray):
        level = [value]
        for _ in range(_MOST_AXES):
            if not all(isinstance(one, list | tuple | int | float | np.number | np.bool_) for one in level):
                raise InvalidActionError(f"{key} is no array of numbers but {type(value).__name__}")
            level = [inner for one in level if isinstance(one, list | tuple) for inner in one]
        if level:
            raise InvalidActionError(f"{key} has more than {_MOST_AXES} axes")
    try:
        rows = np.asarray(value)
    except ValueError as error:
        raise InvalidActionError(f"{key} is no array: its rows differ in length") from error
    if rows.dtype.kind not in _KINDS:
        raise InvalidActionError(f"{key} is no array of numbers but {type(value).__name__}")
    return rows


def array_of(content: object, dtype: object, shape: object) -> np.ndarray:
    """An array from its bytes, the name of its dtype and its shape, as a server tells them.

    Raises:
        DamagedError: the dtype is not one of plain numbers, or the bytes are not as many as the shape says.
    """
    if not isinstance(content, bytes | bytearray) or not isinstance(dtype, str | bytes):
        raise DamagedError("an array needs bytes and the name of a dtype")
    name = dtype.decode("ascii", "replace") if isinstance(dtype, bytes) else dtype
    try:
        # A text with a comma or a bracket would make a dtype of several parts.
        kind = np.dtype(name) if name.isascii() and not set(name) & set(",[](){}: ") and len(name) <= 16 else None
    except (TypeError, ValueError, SyntaxError):
        kind = None
    if kind is None or kind.kind not in _KINDS or kind.itemsize > _WIDEST:
        raise DamagedError(f"{name[:40]!r} is no dtype of plain numbers")
    if not isinstance(shape, list | tuple) or len(shape) > _MOST_AXES:
        raise DamagedError("a shape is a list of at most 8 whole numbers")
    if not all(isinstance(size, int) and not isinstance(size, bool) and 0 <= size <= LARGEST for size in shape):
        raise DamagedError(f"{str(shape)[:60]} is no shape")
    if math.prod(shape) * kind.itemsize != len(content):
        raise DamagedError(f"{len(content)} bytes are no array of {kind} {tuple(shape)}")
    return np.frombuffer(bytes(content), kind).reshape(tuple(shape))


def rows_of(value: object, key: str, width: int) -> Array:
    """A server's actions as finite numbers (actions, width); one row alone is one action.

    Raises:
        InvalidActionError: they are not of that shape, none or too many, or not finite.
    """
    rows = plain_numbers(value, key)
    if rows.size > MOST_VALUES:
        raise InvalidActionError(f"{key} has the shape {rows.shape}, more than {MOST_VALUES} numbers")
    whole = np.atleast_2d(rows.astype(np.float64))
    if whole.ndim != 2 or whole.shape[1] != width:
        raise InvalidActionError(f"{key} has the shape {rows.shape}, not (actions, {width})")
    if not 1 <= len(whole) <= MOST_ACTIONS:
        raise InvalidActionError(f"{key} holds {len(whole)} actions, not 1 to {MOST_ACTIONS}")
    if not np.isfinite(whole).all():
        first = int(np.argwhere(~np.isfinite(whole))[0][0])
        raise InvalidActionError(f"{key} is not finite, first in action {first}")
    return whole


def period_of(value: Any, key: str) -> float | None:
    """How long an action lasts (s), by a server's number of ms; None for none, or 0.

    Raises:
        InvalidActionError: it is no number, or far from any that a robot could use.
    """
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not math.isfinite(value):
        raise InvalidActionError(f"{key} is {str(value)[:40]!r}, not a number of ms")
    seconds = float(value) / 1000
    if seconds == 0:
        return None
    if not SHORTEST <= seconds <= LONGEST:
        raise InvalidActionError(f"{key} is {float(value):g} ms, not {SHORTEST * 1000:g} to {LONGEST * 1000:g}")
    return seconds
