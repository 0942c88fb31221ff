"""openpi's protocol: a WebSocket on which the server speaks first, and msgpack with arrays as mappings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np

from ..errors import ResourceError
from .bounds import LARGEST, Budget, DamagedError, array_of
from .peer import RemoteError, address_of, answering, nobody
from .websocket import WebSocket
from .wire import require_msgpack

SCHEME = "ws"


class OpenpiClient:
    """Asks a server over a connection that it keeps; one that is gone is made again for the next trial.

    Args:
        url: `ws://HOST:PORT`.
        timeout: seconds to wait for a part of an answer.

    Raises:
        UsageError: the URL is not valid.
        ResourceError: msgpack is not installed, or no such server answers.
    """

    def __init__(self, url: str, timeout: float) -> None:
        require_msgpack()
        self._url, self._timeout = url, timeout
        host, port = address_of(url, SCHEME, 8000)
        host = f"[{host}]" if ":" in host else host
        self._address = f"{SCHEME}://{host}:{port}{urlsplit(url).path or '/'}"
        self._socket: WebSocket | None = None
        try:
            self._connection()
        except (RemoteError, TimeoutError) as error:
            raise ResourceError(str(nobody(url, error))) from error

    def begin(self, seed: int) -> None:
        """Connect again if the connection was lost, since the server closes it after an error. Raises as `ask`."""
        self._connection()

    def ask(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """The server's answer.

        Raises:
            RemoteError: it is gone, or answers with an error or something else than a message.
            TimeoutError: there is none in time.
        """
        return self._receive(self._connection(), pack_openpi(message))

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connection(self) -> WebSocket:
        if self._socket is not None:
            return self._socket
        with answering(self._url, self.close):
            made = self._socket = WebSocket(self._address, self._timeout, LARGEST)
        # It says first what it is; nothing of that is needed.
        self._receive(made)
        return made

    def _receive(self, connection: WebSocket, question: bytes | None = None) -> Mapping[str, Any]:
        with answering(self._url, self.close):
            if question is not None:
                connection.send(question)
            data = connection.receive()
            if isinstance(data, str):
                # The last line of a traceback says what went wrong.
                raise RemoteError(f"{self._url}: {(data.strip().splitlines() or ['an error'])[-1][:300]}", data)
            try:
                return unpack_openpi(data)
            except DamagedError as error:
                raise RemoteError(f"{self._url} answers with no message: {error}") from error


def pack_openpi(message: Mapping[str, Any]) -> bytes:
    """A message as openpi's packer writes it."""
    import msgpack

    return cast("bytes", msgpack.packb(message, default=_array))


def unpack_openpi(data: bytes) -> dict[str, Any]:
    """The mapping in bytes; arrays in it are read-only.

    Raises:
        DamagedError: they are no mapping, hold too many values, or an array in it is damaged.
    """
    import msgpack

    try:
        budget = Budget()
        found = msgpack.unpackb(
            data,
            object_hook=lambda one: _whole(budget.spend(one)),
            list_hook=budget.spend,
            raw=False,
            strict_map_key=False,
        )
    except DamagedError:
        raise
    # Nested thousands of times, or with keys that cannot be keys.
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise DamagedError(f"no msgpack: {str(error)[:100]}") from error
    if not isinstance(found, dict):
        raise DamagedError(f"{type(found).__name__} in place of a mapping")
    return found


def _array(value: object) -> dict[bytes, Any]:
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value).tobytes()
        return {b"__ndarray__": True, b"data": content, b"dtype": value.dtype.str, b"shape": list(value.shape)}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _whole(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        return array_of(found.get(b"data"), found.get(b"dtype"), found.get(b"shape"))
    # A number with the name of its dtype: the number suffices.
    return found.get(b"data") if b"__npgeneric__" in found else found
