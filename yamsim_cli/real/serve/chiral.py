"""WebSocket server for raiden's policies, by the chiral protocol of TRI-ML.

A message has a header's length (4 bytes), the header in msgpack, and raw arrays. Reading never executes code. Source:
TRI-ML/chiral f7293d7, protocol.py.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from yamsim_cli.core.extras import require_library
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.http_origin import refusal_reason

from .policy_robot import PolicyRobot, RobotObservation
from .socket_servers import ClientConnection, TcpServer

_READ_BYTES = 65_536  # largest number of bytes per read from a client
HANDSHAKE_SECONDS = 5.0  # s in which a client must complete the WebSocket handshake
MAX_QUEUED = 256  # unanswered messages above which a client is dropped
_MESSAGES_PER_STEP = 2  # messages of a client that are answered before physics continues

MAX_MESSAGE_BYTES = 65_536  # an action has some hundred bytes
_MAX_ACTION_NUMBERS = 256
_DTYPES = ("float16", "float32", "float64")  # types of an action's values

_METADATA, _RESET, _OBSERVATION, _ACTION = "metadata", "reset", "obs_request", "apply_action"  # requests


class ChiralError(ValueError):
    """Received bytes are no chiral message."""


@dataclass
class _ChiralConnection:
    """Protocol state of one client.

    Attributes:
        protocol: WebSocket protocol without a socket.
        began: s of the monotonic clock.
        messages: unanswered, oldest first.
        parts: of an incomplete message.
        pending: request that waits for images from simulated time `min_image_sim_time`, s, or later.
        drives: has sent an action, so the arms stop when its connection ends.
    """

    protocol: Any
    opened_at: float
    messages: deque[bytes] = field(default_factory=deque)
    parts: bytearray = field(default_factory=bytearray)
    pending_request: str = ""
    min_image_sim_time: float = 0.0
    has_sent_action: bool = False


class ChiralServer(TcpServer):
    """Serves one robot to raiden's policies. The caller closes the server; no method blocks.

    Other sites' web pages are refused: a browser would let any page reach the port.

    Raises:
        ResourceError: msgpack or websockets is not installed, or the server cannot listen on the port.
    """

    def __init__(self, robot: PolicyRobot, host: str, port: int) -> None:
        for library in ("msgpack", "websockets"):
            require_library("--chiral", library, "remote")
        self._robot, self._host = robot, host
        super().__init__(host, port, "--chiral", _READ_BYTES)
        self._connections: dict[ClientConnection, _ChiralConnection] = {}

    def handle(self, ready: set[Any]) -> None:
        """Receive messages, and answer them."""
        for client in self.receive_from_clients(ready):
            self._receive_messages(client, self._connection_of(client))

    def flush(self) -> None:
        """Answer requests whose images are ready, send bytes, and stop arms whose client has gone."""
        from websockets.protocol import State

        now = time.monotonic()
        clients = self.clients
        for client in clients:
            self._connection_of(client)
        for client, connection in list(self._connections.items()):
            if client not in clients:
                self._end_connection(client)
            elif connection.protocol.state is State.CONNECTING and now > connection.opened_at + HANDSHAKE_SECONDS:
                self.drop_client(client)
            else:
                self._answer_messages(client, connection)

    def _connection_of(self, client: ClientConnection) -> _ChiralConnection:
        from websockets.server import ServerProtocol

        if client not in self._connections:
            protocol = ServerProtocol(max_size=MAX_MESSAGE_BYTES)
            self._connections[client] = _ChiralConnection(protocol, time.monotonic())
        return self._connections[client]

    def _receive_messages(self, client: ClientConnection, connection: _ChiralConnection) -> None:
        from websockets.frames import Frame, Opcode
        from websockets.http11 import Request

        protocol = connection.protocol
        protocol.receive_data(bytes(client.received))
        client.received.clear()
        for event in protocol.events_received():
            if isinstance(event, Request):
                headers = event.headers
                refused = refusal_reason(headers.get_all("Host"), headers.get_all("Origin"), self._host)
                protocol.send_response(protocol.accept(event) if refused is None else protocol.reject(403, refused))
            elif isinstance(event, Frame) and event.opcode in (Opcode.BINARY, Opcode.TEXT, Opcode.CONT):
                connection.parts += event.data
                if event.fin:
                    connection.messages.append(bytes(connection.parts))
                    connection.parts.clear()
        if len(connection.messages) > MAX_QUEUED:
            protocol.fail(1008, "too many messages at once")
            connection.messages.clear()
        self._answer_messages(client, connection)

    def _answer_messages(self, client: ClientConnection, connection: _ChiralConnection) -> None:
        """Answer up to `_MESSAGES_PER_STEP` messages in order, but none while unsent bytes wait."""
        try:
            for _ in range(_MESSAGES_PER_STEP):
                if (
                    not self._send_protocol_data(client, connection)
                    or client.outgoing
                    or not self._answer_next(connection)
                ):
                    return
        except (ChiralError, ValueError) as error:
            connection.messages.clear()
            connection.pending_request = ""
            connection.protocol.fail(1008, str(error)[:100])
        self._send_protocol_data(client, connection)

    def _answer_next(self, connection: _ChiralConnection) -> bool:
        if connection.pending_request:
            return self._answer_pending(connection)
        if connection.messages:
            self._handle_message(connection, connection.messages.popleft())
            return True
        return False

    def _handle_message(self, connection: _ChiralConnection, message: bytes) -> None:
        kind, numbers = read_message(message)
        if kind == _METADATA:
            connection.protocol.send_binary(
                _pack_header({"type": "metadata_response", "data": dict(self._robot.metadata)})
            )
        elif numbers is not None:
            self._robot.queue_action(numbers)
            connection.has_sent_action = True
        else:
            connection.pending_request, connection.min_image_sim_time = kind, 0.0
            if kind == _RESET:
                self._robot.reset()

    def _answer_pending(self, connection: _ChiralConnection) -> bool:
        robot, shot = self._robot, self._robot.camera_frames
        is_reset = connection.pending_request == _RESET
        if is_reset and robot.is_going_home:
            connection.min_image_sim_time = robot.sim_time
        elif shot is not None and shot.sim_time >= connection.min_image_sim_time:
            connection.pending_request = ""
            connection.protocol.send_binary(_observation_message(robot.observe(shot), is_reset=is_reset))
            return True
        return False

    def _send_protocol_data(self, client: ClientConnection, connection: _ChiralConnection) -> bool:
        """Return whether the connection stays open."""
        over = False
        for data in connection.protocol.data_to_send():
            over = over or not data  # an empty item ends the connection
            client.outgoing += data
        if client.outgoing:
            self.send_outgoing(client)
        if over:
            self.drop_client(client)
        return not over

    def _end_connection(self, client: ClientConnection) -> None:
        if self._connections.pop(client).has_sent_action and not self._robot.stop_reason:
            self._robot.stop("the program that drove the arms has disconnected; reset to continue")


def read_message(message: bytes) -> tuple[str, Array | None]:
    """Return a request's type, and an action's numbers (n,), if any.

    Raises:
        ChiralError: the bytes are no valid message.
    """
    import msgpack

    length = int.from_bytes(message[:4], "little")
    if len(message) < 4 or not 1 <= length <= len(message) - 4:
        raise ChiralError("the length of the header is wrong")
    try:
        header = msgpack.unpackb(message[4 : 4 + length], raw=False, strict_map_key=True)
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise ChiralError("the header is not msgpack") from error
    kind = header.get("type") if isinstance(header, dict) else None
    if kind in (_METADATA, _RESET, _OBSERVATION):
        return str(kind), None
    if kind != _ACTION:
        raise ChiralError(f"a message is one of {_METADATA}, {_RESET}, {_OBSERVATION} and {_ACTION}")
    return _ACTION, _action_numbers(header.get("shape"), header.get("dtype"), message[4 + length :])


def _action_numbers(shape: Any, dtype: Any, data: bytes) -> Array:
    if dtype not in _DTYPES:
        raise ChiralError(f"an action's dtype is one of {', '.join(_DTYPES)}")
    if not isinstance(shape, list) or not 1 <= len(shape) <= 3 or not all(type(n) is int and n > 0 for n in shape):
        raise ChiralError("an action's shape is not valid")
    count = math.prod(shape)
    if count > _MAX_ACTION_NUMBERS or count * np.dtype(dtype).itemsize != len(data):
        raise ChiralError("the bytes of an action do not match its shape")
    numbers: Array = np.frombuffer(data, dtype).astype(np.float64)
    return numbers


def _observation_message(observation: RobotObservation, *, is_reset: bool) -> bytes:
    parts: list[bytes] = []
    at = 0

    def append_binary_part(data: bytes) -> tuple[int, int]:
        nonlocal at
        parts.append(data)
        at += len(data)
        return at - len(data), len(data)

    cameras = []
    for name, view in observation.views.items():
        start, size = append_binary_part(view.picture.tobytes())
        cameras.append(
            {
                "name": name,
                "timestamp": view.time_ns,
                "intrinsics": view.K.ravel().tolist(),
                "extrinsics": view.T_cam_in_base.ravel().tolist(),
                "image_shape": list(view.picture.shape),
                "image_dtype": "uint8",
                "image_offset": start,
                "image_size": size,
            }
        )
    proprios = []
    for name, values in observation.proprios.items():
        start, size = append_binary_part(np.asarray(values, np.float32).tobytes())
        proprios.append({"name": name, "dtype": "float32", "offset": start, "size": size})
    header = {
        "type": "reset_response" if is_reset else "obs_response",
        "timestamp": observation.time,
        "cameras": cameras,
        "proprios": proprios,
        "extra": dict(observation.extra),
        **({"info": {}} if is_reset else {}),
    }
    return _pack_header(header) + b"".join(parts)


def _pack_header(header: Mapping[str, Any]) -> bytes:
    import msgpack

    packed: bytes = msgpack.packb(header)
    return len(packed).to_bytes(4, "little") + packed
