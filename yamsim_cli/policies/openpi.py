"""Client of openpi's protocol: a WebSocket on which the server sends first, and msgpack with arrays as mappings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np

from yamsim_cli.core.extras import require_library

from ..core.errors import ResourceError
from .policy_client import (
    MAX_ANSWER_BYTES,
    DamagedMessageError,
    RemoteError,
    ValueCounter,
    array_from_bytes,
    no_answer_error,
    parse_address,
    request_context,
)

SCHEME = "ws"  # scheme of an openpi server's URL
_CLOSE_S = 0.5  # s, for a connection's closing handshake
_MESSAGE_TOO_BIG = 1009  # WebSocket close code. Source: RFC 6455, section 7.4.1


class WebSocketError(ConnectionError):
    """The server does not speak WebSocket, sent a message that is too long, or closed the connection."""


class WebSocket:
    """WebSocket client with limits on waiting times and message sizes.

    `timeout` is for the connection and for each message, s. TimeoutError, OSError and WebSocketError mean that no
    server answers in time, listens, or speaks the protocol.
    """

    def __init__(self, url: str, timeout: float) -> None:
        require_library("a policy behind ws://", "websockets", "remote")
        from websockets.exceptions import ConnectionClosed, WebSocketException
        from websockets.sync.client import connect

        self._closed, self._timeout = ConnectionClosed, timeout
        try:
            self._connection = connect(
                url,
                compression=None,
                # Ignore a proxy that the environment names.
                proxy=None,
                # openpi answers no ping while it computes an action.
                ping_interval=None,
                open_timeout=timeout,
                close_timeout=_CLOSE_S,
                max_size=MAX_ANSWER_BYTES,
            )
        except WebSocketException as error:
            raise WebSocketError(f"it does not speak WebSocket: {error}") from error

    def send(self, data: bytes) -> None:
        """Send a binary message. Raise WebSocketError if the server has closed the connection."""
        try:
            self._connection.send(data)
        except self._closed as error:
            raise WebSocketError(str(error)) from error

    def receive(self) -> bytes | str:
        """Return the next message as bytes or text.

        Raise TimeoutError without a message, and WebSocketError for a damaged one or a closed connection.
        """
        try:
            return self._connection.recv(self._timeout)
        except self._closed as error:
            if error.sent is not None and error.sent.code == _MESSAGE_TOO_BIG:
                raise WebSocketError(f"its message is longer than {MAX_ANSWER_BYTES} bytes") from error
            raise WebSocketError(str(error)) from error
        except UnicodeDecodeError as error:
            raise WebSocketError(f"its text is not UTF-8: {error}") from error

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


class OpenpiClient:
    """Client of an openpi server, which connects again when the connection is lost.

    Args:
        timeout: for the connection and for each message, s.
    """

    def __init__(self, url: str, timeout: float) -> None:
        require_library("a policy in another process", "msgpack", "remote")
        self._url, self._timeout = url, timeout
        host, port = parse_address(url, SCHEME, 8000)
        host = f"[{host}]" if ":" in host else host
        self._address = f"{SCHEME}://{host}:{port}{urlsplit(url).path or '/'}"
        self._socket: WebSocket | None = None
        try:
            self._connected_socket()
        except (RemoteError, TimeoutError) as error:
            raise ResourceError(str(no_answer_error(url, error))) from error

    def begin_trial(self, seed: int) -> None:
        """Connect again if the connection is lost, as after an error of the server. Raises the errors of `infer`."""
        self._connected_socket()

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the server's answer to an observation's message. Raise RemoteError or TimeoutError without a valid
        answer.
        """
        return self._request_answer(self._connected_socket(), pack_openpi(message))

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected_socket(self) -> WebSocket:
        if self._socket is not None:
            return self._socket
        with request_context(self._url, self.close):
            made = self._socket = WebSocket(self._address, self._timeout)
        # Discard the metadata, which the server sends first.
        self._request_answer(made)
        return made

    def _request_answer(self, connection: WebSocket, question: bytes | None = None) -> Mapping[str, Any]:
        with request_context(self._url, self.close):
            if question is not None:
                connection.send(question)
            data = connection.receive()
            if isinstance(data, str):
                # A text is a traceback, whose last line names the error.
                raise RemoteError(f"{self._url}: {(data.strip().splitlines() or ['an error'])[-1][:300]}", data)
            try:
                return unpack_openpi(data)
            except DamagedMessageError as error:
                raise RemoteError(f"{self._url} answers without a valid message: {error}") from error


def pack_openpi(message: Mapping[str, Any]) -> bytes:
    """Encode a message as openpi's client does."""
    import msgpack

    return cast("bytes", msgpack.packb(message, default=_encode))


def unpack_openpi(data: bytes) -> dict[str, Any]:
    """Decode a mapping with openpi's encoding of arrays, which become read-only."""
    import msgpack

    try:
        budget = ValueCounter()
        found = msgpack.unpackb(
            data,
            object_hook=lambda one: _decode(budget.spend(one)),
            list_hook=budget.spend,
            raw=False,
            strict_map_key=False,
        )
    except DamagedMessageError:
        raise
    # RecursionError: thousands of nested containers. TypeError: keys that cannot be hashed.
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise DamagedMessageError(f"not msgpack: {str(error)[:100]}") from error
    if not isinstance(found, dict):
        raise DamagedMessageError(f"{type(found).__name__} instead of a mapping")
    return found


def _encode(value: object) -> dict[bytes, Any]:
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value).tobytes()
        return {b"__ndarray__": True, b"data": content, b"dtype": value.dtype.str, b"shape": list(value.shape)}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _decode(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        return array_from_bytes(found.get(b"data"), found.get(b"dtype"), found.get(b"shape"))
    # A scalar has its value and the name of its dtype. The value suffices.
    return found.get(b"data") if b"__npgeneric__" in found else found
