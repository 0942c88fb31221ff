"""chiral's port: the robot as the WebSocket server that raiden's policies are run against."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from ..page_origin import refusal
from . import chiral_wire
from .chiral_wire import ChiralError
from .connections import Program, Server, listen_at
from .policy_robot import PolicyRobot

_READ_BYTES = 65_536
# How long a program may take until it speaks WebSocket, s.
_GREETING_S = 5.0
# Messages of one program that wait; one that says more is hung up on.
_MOST_WAITING = 256
# Messages of one program that are answered before physics goes on.
_AT_ONCE = 2


@dataclass
class _Client:
    """One program's side of the protocol.

    Attributes:
        protocol: of WebSocket, without any socket.
        came: when, by the clock.
        messages: that are not answered yet, oldest first.
        parts: of a message whose end has not come.
        due: what it waits for: an answer to a reset or to a request, once there are pictures taken after `since`.
        drives: whether it has sent an action.
    """

    protocol: Any
    came: float
    messages: deque[bytes] = field(default_factory=deque)
    parts: bytearray = field(default_factory=bytearray)
    due: str = ""
    since: float = 0.0
    drives: bool = False


class ChiralServer(Server):
    """Answers raiden's policies about one robot; close it. It never blocks.

    Web pages of other sites are refused: a browser would let any of them reach this port.

    Attributes:
        port: on which it listens.

    Raises:
        ResourceError: msgpack or websockets are not installed, or the port cannot be had.
    """

    def __init__(self, robot: PolicyRobot, host: str, port: int) -> None:
        chiral_wire.require_libraries()
        self._robot, self._host = robot, host
        listener = listen_at(host, port, "--chiral")
        super().__init__(listener, _READ_BYTES)
        self._clients: dict[Program, _Client] = {}
        self.port = int(listener.getsockname()[1])

    def handle(self, ready: set[Any]) -> None:
        """Take what programs say."""
        for program in self._connections.heard(ready):
            client = self._clients.get(program)
            if client is None:
                client = self._clients[program] = _Client(_new_protocol(), time.monotonic())
            self._hear(program, client)

    def flush(self) -> None:
        """Answer whom there is something for, send what waits, and let go of who is gone."""
        from websockets.protocol import State

        now = time.monotonic()
        there = set(self._connections.programs)
        for program in there - self._clients.keys():
            self._clients[program] = _Client(_new_protocol(), now)
        for program, client in list(self._clients.items()):
            if program not in there:
                self._forget(program)
            elif client.protocol.state is State.CONNECTING and now > client.came + _GREETING_S:
                self._connections.drop(program)
            else:
                self._work(program, client)

    def _hear(self, program: Program, client: _Client) -> None:
        from websockets.frames import Frame, Opcode
        from websockets.http11 import Request

        protocol = client.protocol
        protocol.receive_data(bytes(program.came))
        program.came.clear()
        for event in protocol.events_received():
            if isinstance(event, Request):
                protocol.send_response(self._answer_request(protocol, event))
            elif isinstance(event, Frame) and event.opcode in (Opcode.BINARY, Opcode.TEXT, Opcode.CONT):
                client.parts += event.data
                if event.fin:
                    client.messages.append(bytes(client.parts))
                    client.parts.clear()
        if len(client.messages) > _MOST_WAITING:
            protocol.fail(1008, "too many messages at once")
            client.messages.clear()
        self._work(program, client)

    def _answer_request(self, protocol: Any, request: Any) -> Any:
        """The response to a request for a WebSocket."""
        headers = request.headers
        refused = refusal(headers.get_all("Host"), headers.get_all("Origin"), self._host)
        return protocol.accept(request) if refused is None else protocol.reject(403, refused)

    def _work(self, program: Program, client: _Client) -> None:
        """Answer some messages in their order, and send; what a program has not taken yet holds the next answer up."""
        try:
            for _ in range(_AT_ONCE):
                if not self._send(program, client) or program.waits or not self._go_on(client):
                    return
        except (ChiralError, ValueError) as error:
            client.messages.clear()
            client.due = ""
            client.protocol.fail(1008, str(error)[:100])
        self._send(program, client)

    def _go_on(self, client: _Client) -> bool:
        """Answer what a program waits for, or take its next message; whether there was something to do."""
        if client.due:
            return self._answer(client)
        if client.messages:
            self._take(client, client.messages.popleft())
            return True
        return False

    def _take(self, client: _Client, message: bytes) -> None:
        kind, numbers = chiral_wire.read(message)
        if kind == chiral_wire.METADATA:
            client.protocol.send_binary(chiral_wire.metadata(self._robot.metadata))
        elif numbers is not None:
            self._robot.act(numbers)
            client.drives = True
        else:
            client.due, client.since = kind, 0.0
            if kind == chiral_wire.RESET:
                self._robot.reset()

    def _answer(self, client: _Client) -> bool:
        """Give what a program waits for; whether it was there."""
        robot, shot = self._robot, self._robot.shot
        resets = client.due == chiral_wire.RESET
        if resets and robot.is_going_home:
            client.since = robot.now
        elif shot is not None and shot.sim_time >= client.since:
            client.due = ""
            client.protocol.send_binary(chiral_wire.observation(robot.observed(shot), reset=resets))
            return True
        return False

    def _send(self, program: Program, client: _Client) -> bool:
        """Hand on what the protocol has to say; whether the program is still there."""
        over = False
        for data in client.protocol.data_to_send():
            over = over or not data  # An empty one is its end.
            program.waits += data
        if program.waits:
            self._connections.flush(program)
        if over:
            self._connections.drop(program)
        return not over

    def _forget(self, program: Program) -> None:
        if self._clients.pop(program).drives and not self._robot.stopped:
            self._robot.stop("the program that drove the arms has gone; reset to go on")


def _new_protocol() -> Any:
    from websockets.server import ServerProtocol

    return ServerProtocol(max_size=chiral_wire.LARGEST)
