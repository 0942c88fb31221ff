"""Client of a policy in another process or machine, over HTTP with msgpack messages, which execute no code."""

from __future__ import annotations

import contextlib
import http.client
import math
from collections.abc import Mapping
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np

from yamsim_cli.core.extras import require_library

from ..core.errors import ResourceError, UsageError
from .policy_client import MAX_TEXT, RemoteError, ValueCounter, plain_numbers, read_body, request_context
from .policy_protocol import InvalidActionError, Observation

PROTOCOL = 1  # a server refuses clients with another version

_ARRAY_TYPE = 1  # msgpack's extension type of an array
_DTYPE_KINDS = "biuf"  # booleans, integers and floating-point numbers


class MessageError(ValueError):
    """Received bytes are no message of the protocol."""


class UnsendableError(MessageError):
    """A policy's answer cannot be sent."""


class RemotePolicy:
    """Policy that requests each action from a `policy_server.PolicyServer`, which keeps a session for each client.

    An action lasts `ticks` control ticks. `timeout` is for an answer, s.
    """

    def __init__(self, url: str, timeout: float) -> None:
        require_library("a policy in another process", "msgpack", "remote")
        parts = urlsplit(url)
        if parts.scheme != "http" or not parts.hostname or parts.path.strip("/"):
            raise UsageError(f"--policy {url} is not valid: give http://HOST:PORT")
        self._url = url
        self._connection = http.client.HTTPConnection(parts.hostname, parts.port or 80, timeout=timeout)
        try:
            session = self._request("session", {"protocol": PROTOCOL})
            self.images, self.ticks = tuple(session["images"]), int(session["ticks"])
            # Older servers do not send `wants`.
            self.wants = tuple(session.get("wants", ()))
            self._session = session["session"]
        except (OSError, RemoteError, KeyError, TypeError, ValueError) as error:
            raise ResourceError(
                f"--policy {url}: no policy answers there: {error}; start one with yamsim serve-policy"
            ) from error

    def reset(self, seed: int) -> None:
        """Reset the server's policy for a new trial."""
        self._request("reset", {"session": self._session, "seed": seed})

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Return the answer of the server's policy. Raise RemoteError, TimeoutError or InvalidActionError otherwise."""
        answer = self._request("act", {"session": self._session, "observation": dict(observation)})
        action = answer.get("action")
        if not isinstance(action, dict):
            raise RemoteError(f"{self._url} answers without an action")
        for key, value in action.items():
            if value is not None:
                plain_numbers(value, str(key)[:40])
        return action

    def close(self) -> None:
        """End the session and close the connection."""
        with contextlib.suppress(OSError, RemoteError, AttributeError):
            self._request("close", {"session": self._session})
        self._connection.close()

    def _request(self, what: str, message: Mapping[str, Any]) -> dict[str, Any]:
        with request_context(self._url, self._connection.close):
            self._connection.request("POST", f"/{what}", pack_message(message), {"Content-Type": "application/msgpack"})
            response = self._connection.getresponse()
            data = read_body(response)
        try:
            answer = unpack_message(data)
        except MessageError as error:
            raise RemoteError(f"{self._url} answers {response.status} without a message of this protocol") from error
        if not isinstance(answer, dict):
            raise RemoteError(f"{self._url} answers with {type(answer).__name__}")
        if answer.get("invalid"):
            raise InvalidActionError(str(answer.get("error"))[:MAX_TEXT])
        if "error" in answer:
            raise RemoteError(str(answer["error"]), str(answer.get("traceback", "")))
        return answer


def pack_message(message: Any) -> bytes:
    """Encode a message as msgpack."""
    import msgpack

    return cast("bytes", msgpack.packb(message, default=_pack_array, use_bin_type=True))


def require_sendable(answer: Any) -> dict[str, Any]:
    """Return a policy's answer as a dictionary. Raise UnsendableError if it cannot be sent."""
    if not isinstance(answer, Mapping):
        raise UnsendableError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    for key, value in answer.items():
        try:
            unpack_message(pack_message({key: value}))
        # Arrays of other libraries, recursion and huge numbers may raise any exception.
        except Exception as error:
            raise UnsendableError(f"{key} of the answer: {error}") from error
    return dict(answer)


def unpack_message(data: bytes) -> Any:
    """Decode a message of `pack_message`. Raise MessageError for other bytes, and for too many values."""
    import msgpack

    try:
        budget = ValueCounter()
        return msgpack.unpackb(
            data,
            ext_hook=_unpack_array,
            object_hook=budget.spend,
            list_hook=budget.spend,
            raw=False,
            strict_map_key=True,
        )
    except (ValueError, TypeError, msgpack.exceptions.UnpackException) as error:
        raise MessageError(f"not a message: {error}") from error


def _pack_array(value: Any) -> Any:
    import msgpack

    if isinstance(value, np.generic):
        return value.item()
    try:
        # `asarray` converts tensors of all libraries, except tensors on a GPU or with gradients.
        array = np.asarray(value)
    # Libraries raise exceptions of different types.
    except Exception as error:
        raise TypeError(f"{type(value).__name__} cannot be sent: {error}") from error
    if array.dtype.kind not in _DTYPE_KINDS:
        what = f"an array of dtype {array.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise TypeError(f"{what} cannot be sent: only numbers, text, plain containers and arrays can")
    content = np.ascontiguousarray(array).tobytes()
    return msgpack.ExtType(_ARRAY_TYPE, msgpack.packb([array.dtype.str, list(array.shape), content]))


def _unpack_array(code: int, data: bytes) -> Any:
    import msgpack

    if code != _ARRAY_TYPE:
        raise MessageError(f"unknown type {code}")
    kind, shape, content = msgpack.unpackb(data)
    dtype = np.dtype(str(kind))
    if dtype.kind not in _DTYPE_KINDS or math.prod(shape) * dtype.itemsize != len(content):
        raise MessageError(f"{len(content)} bytes do not fit an array of {dtype} {shape}")
    return np.frombuffer(content, dtype).reshape(shape).copy()
