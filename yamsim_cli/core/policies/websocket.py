"""A WebSocket client (RFC 6455) that waits, without compression, and with a limit on what it reads."""

from __future__ import annotations

import base64
import hashlib
import os
import socket
import struct

import numpy as np

_GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_MORE, _TEXT, _BINARY, _CLOSE, _PING, _PONG = 0, 1, 2, 8, 9, 10
_MOST_HEADERS = 16_000
# A message in very many small pieces, or pings without end, would be waited for without end.
_MOST_FRAMES = 4096


class WebSocketError(ConnectionError):
    """The other side does not speak WebSocket, says too much, or has closed."""


class WebSocket:
    """A connection to a server.

    Args:
        path: of the URL, from `/` on.
        timeout: seconds to wait for a part of an answer.
        largest: bytes of the longest message that is read.

    Raises:
        OSError: nobody listens there.
        WebSocketError: whoever does, speaks another protocol.
    """

    def __init__(self, host: str, port: int, path: str, timeout: float, largest: int) -> None:
        self._largest = largest
        self._rest = b""
        self._socket = socket.create_connection((host, port), timeout)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._shake_hands(f"[{host}]:{port}" if ":" in host else f"{host}:{port}", path)
        except BaseException:
            self._socket.close()
            raise

    def send(self, data: bytes) -> None:
        """Send a binary message."""
        self._send(_BINARY, data)

    def receive(self) -> bytes | str:
        """The next message: bytes, or a text.

        Raises:
            TimeoutError: none comes in time.
            WebSocketError: it is too long or damaged, or the other side has closed.
        """
        kind, parts, length = None, [], 0
        for _ in range(_MOST_FRAMES):
            code, is_last, data = self._frame(self._largest - length)
            if code == _PING:
                self._send(_PONG, data)
            elif code == _CLOSE:
                raise WebSocketError(f"it closed: {data[2:].decode(errors='replace')[:200]}".rstrip(": "))
            elif code in (_TEXT, _BINARY, _MORE):
                if (code == _MORE) == (kind is None):
                    raise WebSocketError("its messages are torn apart")
                kind = code if kind is None else kind
                parts.append(data)
                length += len(data)
                if is_last:
                    whole = b"".join(parts)
                    return whole if kind == _BINARY else whole.decode(errors="replace")
            elif code != _PONG:
                raise WebSocketError(f"it sends frames of an unknown kind {code}")
        raise WebSocketError("its message comes in too many pieces")

    def close(self) -> None:
        """Say goodbye, and close the connection, without waiting."""
        try:
            self._send(_CLOSE, struct.pack(">H", 1000))
        except OSError:
            pass
        finally:
            self._socket.close()

    def _shake_hands(self, host: str, path: str) -> None:
        key = base64.b64encode(os.urandom(16))
        lines = [
            f"GET {path} HTTP/1.1",
            f"Host: {host}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key.decode()}",
            "Sec-WebSocket-Version: 13",
        ]
        self._socket.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
        head = b""
        while b"\r\n\r\n" not in head:
            if len(head) > _MOST_HEADERS:
                raise WebSocketError("it speaks no WebSocket")
            head += self._some()
        head, _, self._rest = head.partition(b"\r\n\r\n")
        status, *headers = head.decode("latin-1").split("\r\n")
        told = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in headers)}
        wanted = base64.b64encode(hashlib.sha1(key + _GUID).digest()).decode()
        if status.split(" ")[1:2] != ["101"] or told.get("sec-websocket-accept") != wanted:
            raise WebSocketError(f"it speaks no WebSocket: {status[:100]}")

    def _send(self, code: int, data: bytes) -> None:
        length = len(data)
        if length < 126:
            head = struct.pack(">BB", 0x80 | code, 0x80 | length)
        elif length < 1 << 16:
            head = struct.pack(">BBH", 0x80 | code, 0x80 | 126, length)
        else:
            head = struct.pack(">BBQ", 0x80 | code, 0x80 | 127, length)
        mask = os.urandom(4)
        # Four bytes at a time, whatever their order: a question holds megabytes of pictures.
        content = np.frombuffer(data + bytes(-length % 4), np.uint32) ^ np.frombuffer(mask, np.uint32)[0]
        self._socket.sendall(head + mask + content.tobytes()[:length])

    def _frame(self, room: int) -> tuple[int, bool, bytes]:
        first, second = self._exactly(2)
        if first & 0x70 or second & 0x80:
            raise WebSocketError("its frames are damaged")
        length = second & 0x7F
        if length == 126:
            (length,) = struct.unpack(">H", self._exactly(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._exactly(8))
        if length > max(room, 125):
            raise WebSocketError(f"its message is longer than {self._largest} bytes")
        return first & 0x0F, bool(first & 0x80), self._exactly(length)

    def _exactly(self, count: int) -> bytes:
        parts, missing = [self._rest[:count]], count - len(self._rest[:count])
        self._rest = self._rest[count:]
        while missing:
            parts.append(self._some(min(missing, 1 << 20)))
            missing -= len(parts[-1])
        return b"".join(parts)

    def _some(self, most: int = 4096) -> bytes:
        data = self._socket.recv(most)
        if not data:
            raise WebSocketError("it closed without a word")
        return data
