"""The calls by which programs reach the maker's robot through portal: those of `minimum_gello.py` in its repository."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import portal_wire
from .connections import Program, Server, listen_at
from .follower import Follower
from .portal_wire import PortalError

_READ_BYTES = 65_536
# Bytes of answers that wait for a program which does not read them, before it is hung up on.
_BACKLOG_BYTES = 1_000_000


class PortalServer(Server):
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
        listener = listen_at(host, port, "--portal")
        super().__init__(listener, _READ_BYTES, _BACKLOG_BYTES)
        self.port = int(listener.getsockname()[1])

    def handle(self, ready: set[Any]) -> None:
        """Take and answer what has come on sockets where there is something to read."""
        for program in self._connections.heard(ready):
            self._serve(program)

    def flush(self) -> None:
        """Send on what programs could not take before."""
        self._connections.flush()

    def _serve(self, program: Program) -> None:
        try:
            while (message := _next_message(program)) is not None:
                program.waits += self._answer(message)
        except PortalError:
            self._connections.drop(program)
            return
        self._connections.flush(program)

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


def _next_message(program: Program) -> bytes | None:
    """The next whole message, taken from what has come; None until it has.

    Raises:
        PortalError: what came is no portal's, or says that it is too long.
    """
    came = program.came
    if not program.greeted:
        head = bytes(came[: len(portal_wire.HANDSHAKE)])
        if not portal_wire.HANDSHAKE.startswith(head):
            raise PortalError("this is not portal")
        if len(head) < len(portal_wire.HANDSHAKE):
            return None
        program.greeted = True
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
