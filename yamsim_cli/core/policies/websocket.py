"""A WebSocket client whose waits and messages are bounded, and whose errors are the system's."""

from __future__ import annotations

from ..errors import ResourceError

# Longest wait for the other side's goodbye, s.
_GOODBYE_S = 0.5
# What a connection is closed with that said too much. Source: RFC 6455, section 7.4.1.
_TOO_BIG = 1009


class WebSocketError(ConnectionError):
    """The other side does not speak WebSocket, says too much, or has closed."""


class WebSocket:
    """A connection to a server.

    Args:
        url: `ws://HOST:PORT`, and a path.
        timeout: seconds to wait for the connection, and for each whole message.
        largest: bytes of the longest message that is read.

    Raises:
        ResourceError: the library for it is not installed.
        TimeoutError: no connection comes about in time.
        OSError: nobody listens there.
        WebSocketError: whoever does, speaks another protocol.
    """

    def __init__(self, url: str, timeout: float, largest: int) -> None:
        try:
            from websockets.exceptions import ConnectionClosed, WebSocketException
            from websockets.sync.client import connect
        except ModuleNotFoundError as error:
            raise ResourceError(
                "a policy behind ws:// needs websockets, which is not here: pip install 'yamsim[remote]'"
            ) from error
        self._closed = ConnectionClosed
        self._timeout, self._largest = timeout, largest
        try:
            self._connection = connect(
                url,
                # Pictures hardly get smaller.
                compression=None,
                # Who asks for a server by its address means that one.
                proxy=None,
                # A policy that computes for long answers no ping meanwhile, as openpi's does not.
                ping_interval=None,
                open_timeout=timeout,
                close_timeout=_GOODBYE_S,
                max_size=largest,
            )
        except WebSocketException as error:
            raise WebSocketError(f"it speaks no WebSocket: {error}") from error

    def send(self, data: bytes) -> None:
        """Send a binary message.

        Raises:
            WebSocketError: the other side has closed.
        """
        try:
            self._connection.send(data)
        except self._closed as error:
            raise WebSocketError(str(error)) from error

    def receive(self) -> bytes | str:
        """The next message: bytes, or a text.

        Raises:
            TimeoutError: none comes in time.
            WebSocketError: it is too long or damaged, or the other side has closed.
        """
        try:
            return self._connection.recv(self._timeout)
        except self._closed as error:
            if error.sent is not None and error.sent.code == _TOO_BIG:
                raise WebSocketError(f"its message is longer than {self._largest} bytes") from error
            raise WebSocketError(str(error)) from error
        except UnicodeDecodeError as error:
            raise WebSocketError(f"its text is none: {error}") from error

    def close(self) -> None:
        """Say goodbye, and close the connection."""
        self._connection.close()
