"""The calls by which programs reach the maker's robot through portal: those of `minimum_gello.py` in its repository."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

from ..errors import ResourceError
from . import portal_wire
from .follower import Follower
from .portal_wire import PortalError

# Of the maker's; a second arm has the next one.
PORT = 11333
_MOST_CLIENTS = 16
_READ_BYTES = 65_536
# Bytes of answers that wait for a program which does not read them, before it is hung up on.
_BACKLOG_BYTES = 1_000_000


class _Client:
    """One program: what came from it and is not whole yet, and what waits for it."""

    def __init__(self) -> None:
        self.shook = False
        self.came = bytearray()
        self.waits = bytearray()


class PortalServer:
    """Answers calls about one arm; close it. It never blocks.

    Attributes:
        port: on which it listens.

    Raises:
        ResourceError: msgpack is not installed, or the port cannot be had.
    """

    def __init__(self, follower: Follower, host: str, port: int) -> None:
        portal_wire.require_msgpack()
        self._methods: dict[str, Callable[..., Any]] = {
            "num_dofs": follower.num_dofs,
            "get_joint_pos": follower.joint_pos,
            "command_joint_pos": follower.command_joint_pos,
            "command_joint_state": follower.command_joint_state,
            "get_observations": follower.observations,
        }
        self._clients: dict[socket.socket, _Client] = {}
        try:
            self._listener = socket.create_server((host, port), backlog=_MOST_CLIENTS)
        except OSError as error:
            raise ResourceError(
                f"{host}:{port} cannot be listened on: {error.strerror}; try another --portal"
            ) from error
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])

    @property
    def readers(self) -> list[socket.socket]:
        """What to wait for until there may be something to read."""
        return [self._listener, *self._clients]

    def handle(self, ready: set[socket.socket]) -> None:
        """Take and answer what has come on sockets where there is something to read."""
        if self._listener in ready:
            self._accept()
        for one in ready & self._clients.keys():
            self._read(one)

    def flush(self) -> None:
        """Send on what programs could not take before."""
        for one in [one for one, client in self._clients.items() if client.waits]:
            self._flush(one)

    def close(self) -> None:
        """Hang up on all, and leave the port."""
        for one in list(self._clients):
            self._drop(one)
        self._listener.close()

    def _accept(self) -> None:
        try:
            one, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) >= _MOST_CLIENTS:
            one.close()
            return
        one.setblocking(False)
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[one] = _Client()

    def _read(self, one: socket.socket) -> None:
        client = self._clients[one]
        try:
            data = one.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(one)
            return
        client.came += data
        try:
            while (message := _next_message(client)) is not None:
                client.waits += self._answer(message)
        except PortalError:
            self._drop(one)
            return
        self._flush(one)

    def _answer(self, message: bytes) -> bytes:
        """What is said to a message; a wrong call is told so, and the robot goes on."""
        try:
            number, name, arguments = portal_wire.read_call(message)
        except PortalError as error:
            return portal_wire.refusal(message[:8].ljust(8, b"\0"), f"Could not decode message: {error}")
        method = self._methods.get(name)
        if method is None:
            return portal_wire.refusal(number, f"Unknown method {name!r}; valid: {', '.join(self._methods)}")
        try:
            return portal_wire.answer(number, method(*arguments))
        # Too many arguments, or what is no number: whoever calls is told.
        except (TypeError, ValueError) as error:
            return portal_wire.refusal(number, f"Error in server method: {error}")

    def _flush(self, one: socket.socket) -> None:
        waits = self._clients[one].waits
        try:
            del waits[: one.send(waits)]
        except BlockingIOError:
            if len(waits) > _BACKLOG_BYTES:
                self._drop(one)
        except OSError:
            self._drop(one)

    def _drop(self, one: socket.socket) -> None:
        one.close()
        self._clients.pop(one, None)


def _next_message(client: _Client) -> bytes | None:
    """The next whole message, taken from what has come; None until it has.

    Raises:
        PortalError: what came is no portal's, or says that it is too long.
    """
    came = client.came
    if not client.shook:
        head = bytes(came[: len(portal_wire.HANDSHAKE)])
        if not portal_wire.HANDSHAKE.startswith(head):
            raise PortalError("this is not portal")
        if len(head) < len(portal_wire.HANDSHAKE):
            return None
        client.shook = True
        del came[: len(head)]
    if len(came) < 8:
        return None
    length = int.from_bytes(came[:8], "little")
    if not 1 <= length <= portal_wire.LARGEST:
        raise PortalError(f"a message of {length} bytes is too long")
    if len(came) < 8 + length:
        return None
    message = bytes(came[8 : 8 + length])
    del came[: 8 + length]
    return message
