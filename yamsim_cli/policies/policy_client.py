"""Common code of policy clients: addresses, lost connections, and limits of an answer. Answers never execute code."""

from __future__ import annotations

import http.client
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from ..core.errors import ResourceError, UsageError
from ..core.geometry.se3 import Array
from .policy_faults import PolicyFault
from .policy_protocol import MAX_ACTIONS, MAX_PERIOD, MIN_PERIOD, InvalidActionError

MAX_ANSWER_BYTES = 4_000_000  # 1000 actions of two arms take 150,000 bytes as JSON
MAX_VALUES = 100_000  # values and containers in a message: seven times 1000 actions of two arms
MAX_TEXT = 2_000  # kept characters of an error text
_MAX_TRACEBACK = 50_000  # kept characters, from the end

_MAX_AXES = 8
_DTYPE_KINDS = "biuf"  # booleans, integers and floating-point numbers
_MAX_ITEM_BYTES = 8  # bytes of a number in an array


class DamagedMessageError(ValueError):
    """A server's answer is damaged, or not encoded as the protocol demands."""


class RemoteError(RuntimeError):
    """The server's policy raised an exception, or the server is gone."""

    def __init__(self, text: str, traceback: str = "") -> None:
        text = text[:MAX_TEXT]
        super().__init__(text)
        self.fault = PolicyFault(text, traceback[-_MAX_TRACEBACK:])


class ValueCounter:
    """Limits the number of values in one message. msgpack calls `spend` for each container.

    Small containers take far more memory decoded than encoded, so the limit applies during decoding.
    """

    def __init__(self) -> None:
        self._left = MAX_VALUES

    def spend(self, found: Any) -> Any:
        """Count a container's values and return it. Raise DamagedMessageError above `MAX_VALUES` per message."""
        self._left -= 1 + len(found)
        if self._left < 0:
            raise DamagedMessageError(f"it holds more than {MAX_VALUES} values")
        return found


def check_json(data: bytes) -> None:
    """Raise DamagedMessageError for a JSON text with too many values, before it is decoded."""
    if sum(data.count(mark) for mark in (b",", b"[", b"{")) > MAX_VALUES:
        raise DamagedMessageError(f"it holds more than {MAX_VALUES} values")


def plain_numbers(value: object, key: str) -> np.ndarray:
    """Convert a server's numbers to an array. Texts are refused first, as numpy pads each to the longest."""
    if not isinstance(value, np.ndarray):
        level = [value]
        for _ in range(_MAX_AXES):
            if not all(isinstance(one, list | tuple | int | float | np.number | np.bool_) for one in level):
                raise InvalidActionError(f"{key} is of type {type(value).__name__}, not an array of numbers")
            level = [inner for one in level if isinstance(one, list | tuple) for inner in one]
        if level:
            raise InvalidActionError(f"{key} has more than {_MAX_AXES} axes")
    try:
        rows = np.asarray(value)
    except ValueError as error:
        raise InvalidActionError(f"{key} is not an array: its rows differ in length") from error
    if rows.dtype.kind not in _DTYPE_KINDS:
        raise InvalidActionError(f"{key} is of type {type(value).__name__}, not an array of numbers")
    return rows


def array_from_bytes(content: object, dtype: object, shape: object) -> np.ndarray:
    """Return a read-only array from its bytes, dtype name and shape."""
    if not isinstance(content, bytes | bytearray) or not isinstance(dtype, str | bytes):
        raise DamagedMessageError("an array needs bytes and the name of a dtype")
    name = dtype.decode("ascii", "replace") if isinstance(dtype, bytes) else dtype
    try:
        # A comma or a bracket in the name would make a structured dtype.
        kind = np.dtype(name) if name.isascii() and not set(name) & set(",[](){}: ") and len(name) <= 16 else None
    except (TypeError, ValueError, SyntaxError):
        kind = None
    if kind is None or kind.kind not in _DTYPE_KINDS or kind.itemsize > _MAX_ITEM_BYTES:
        raise DamagedMessageError(f"{name[:40]!r} is not a dtype of plain numbers")
    if not isinstance(shape, list | tuple) or len(shape) > _MAX_AXES:
        raise DamagedMessageError("a shape is a list of at most 8 whole numbers")
    if not all(
        isinstance(size, int) and not isinstance(size, bool) and 0 <= size <= MAX_ANSWER_BYTES for size in shape
    ):
        raise DamagedMessageError(f"{str(shape)[:60]} is not a shape")
    if math.prod(shape) * kind.itemsize != len(content):
        raise DamagedMessageError(f"{len(content)} bytes do not fit an array of {kind} {tuple(shape)}")
    return np.frombuffer(bytes(content), kind).reshape(tuple(shape))


def action_rows(value: object, key: str, width: int) -> Array:
    """Return a server's actions as finite numbers (actions, width). A single row is one action."""
    rows = plain_numbers(value, key)
    if rows.size > MAX_VALUES:
        raise InvalidActionError(f"{key} has the shape {rows.shape}, more than {MAX_VALUES} numbers")
    whole = np.atleast_2d(rows.astype(np.float64))
    if whole.ndim != 2 or whole.shape[1] != width:
        raise InvalidActionError(f"{key} has the shape {rows.shape}, not (actions, {width})")
    if not 1 <= len(whole) <= MAX_ACTIONS:
        raise InvalidActionError(f"{key} holds {len(whole)} actions, not 1 to {MAX_ACTIONS}")
    if not np.isfinite(whole).all():
        first = int(np.argwhere(~np.isfinite(whole))[0][0])
        raise InvalidActionError(f"{key} is not finite, first in action {first}")
    return whole


def action_period(value: Any, key: str) -> float | None:
    """Return the duration of an action, s, from a server's value in ms; None for None or 0."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not math.isfinite(value):
        raise InvalidActionError(f"{key} is {str(value)[:40]!r}, not a number of ms")
    seconds = float(value) / 1000
    if seconds == 0:
        return None
    if not MIN_PERIOD <= seconds <= MAX_PERIOD:
        raise InvalidActionError(f"{key} is {float(value):g} ms, not {MIN_PERIOD * 1000:g} to {MAX_PERIOD * 1000:g}")
    return seconds


def parse_address(url: str, scheme: str, port: int) -> tuple[str, int]:
    """Return host and port of a URL; `port` is the default."""
    try:
        parts = urlsplit(url)
        given = parts.port
    except ValueError:
        parts, given = urlsplit(""), None
    if parts.scheme != scheme or not parts.hostname or parts.query or parts.fragment or parts.username:
        raise UsageError(f"--policy {url} is not valid: give {scheme}://HOST:PORT")
    return parts.hostname, given or port


def no_answer_error(url: str, error: object) -> ResourceError:
    """Return the error for a URL at which no policy server answers."""
    return ResourceError(f"--policy {url}: no policy answers there: {error}; start its server first")


@contextmanager
def request_context(url: str, hang_up: Callable[[], None]) -> Iterator[None]:
    """Context around one request to a policy server. An error closes the connection.

    Otherwise, its late answer could be taken for the answer to the next request. Raises RemoteError and TimeoutError.
    """
    try:
        yield
    except BaseException as error:
        hang_up()
        if isinstance(error, OSError | http.client.HTTPException) and not isinstance(error, TimeoutError):
            raise RemoteError(f"{url}: the connection is lost: {str(error) or type(error).__name__}") from error
        raise


def read_body(response: http.client.HTTPResponse) -> bytes:
    """Return the body of an HTTP answer. Raise HTTPException above `MAX_ANSWER_BYTES`."""
    data = response.read(MAX_ANSWER_BYTES + 1)
    if len(data) > MAX_ANSWER_BYTES:
        raise http.client.HTTPException(f"its answer is longer than {MAX_ANSWER_BYTES} bytes")
    return data
