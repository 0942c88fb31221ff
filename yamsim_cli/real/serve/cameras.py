"""Serve camera images on a Unix socket; `yamsim_cli.camera_reader` is the client.

A message has the JSON's length (4 bytes), JSON, and raw image bytes. Clients request `cameras`, or a camera's `picture`
with a number `after`, and get an image as soon as one has a larger number.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from yamsim_cli.core.errors import UsageError

from ..motors.motor_bus import SILENT, BusFault
from .render_process import CameraFrames, RenderProcess
from .socket_servers import CAMERA_SOCKET, ClientConnection, UnixServer

_MAX_REQUEST_BYTES = 4096  # clients with longer requests are disconnected
_READ_BYTES = 4096


class _InvalidRequestError(ValueError):
    """Received bytes are no valid request."""


class CameraServer(UnixServer):
    """Sends camera images to clients. The caller closes the server; no method blocks.

    Args:
        faults: cameras that send nothing for a time; faults of buses are ignored.

    Raises:
        ResourceError: another program serves cameras in the folder, or the socket cannot be made.
        UsageError: a fault's camera does not exist.
    """

    def __init__(self, folder: Path, source: RenderProcess, faults: Sequence[BusFault] = ()) -> None:
        self._source = source
        self._faults = [fault for fault in faults if fault.kind == SILENT]
        for fault in self._faults:
            if fault.camera not in source.cameras:
                raise UsageError(f"--fault {SILENT}: no camera {fault.camera!r}; valid: {', '.join(source.cameras)}")
        super().__init__(folder / CAMERA_SOCKET, _READ_BYTES)
        # Client -> requested camera, and the number to exceed.
        self._requests: dict[ClientConnection, tuple[str, int]] = {}

    def handle(self, ready: set[Any]) -> None:
        """Receive and answer requests."""
        for client in self.receive_from_clients(ready):
            self._answer_received_requests(client)

    def flush(self) -> None:
        """Answer requests that have a newer image, and send bytes."""
        clients = self.clients
        self._requests = {client: request for client, request in self._requests.items() if client in clients}
        shot = self._source.newest_frames
        for client, (camera, after) in list(self._requests.items()):
            if shot is not None and shot.number > after and not self._is_silent(camera, shot.sim_time):
                del self._requests[client]
                _queue_picture_answer(client, camera, shot)
        super().flush()
        for client in clients:
            if client.received and not client.outgoing:
                self._answer_received_requests(client)

    def _is_silent(self, camera: str, now: float) -> bool:
        return any(fault.camera == camera and fault.is_active(now) for fault in self._faults)

    def _answer_received_requests(self, client: ClientConnection) -> None:
        try:
            # One request at a time: answers must not pile up for a client that sends faster than it reads.
            while not client.outgoing and client not in self._requests:
                if (request := _next_request(client)) is None:
                    break
                self._answer_request(client, request)
                self.send_outgoing(client)
        except _InvalidRequestError:
            self.drop_client(client)
            return
        if len(client.received) > _MAX_REQUEST_BYTES + 4:
            self.drop_client(client)

    def _answer_request(self, client: ClientConnection, request: dict[str, Any]) -> None:
        source = self._source
        kind, camera, after = request.get("ask"), request.get("camera"), request.get("after", -1)
        if kind == "cameras":
            width, height = source.size
            form = {"width": width, "height": height, "fps": source.fps}
            _queue_message(
                client, {"cameras": {name: {**form, "K": source.K[name].ravel().tolist()} for name in source.cameras}}
            )
        elif kind != "picture" or type(after) is not int:
            _queue_message(client, {"error": "a request asks for cameras, or for a picture with camera and after"})
        elif camera not in source.cameras:
            _queue_message(client, {"error": f"there is no camera {camera!r:.80}; valid: {', '.join(source.cameras)}"})
        else:
            self._requests[client] = str(camera), after


def _queue_picture_answer(client: ClientConnection, camera: str, shot: CameraFrames) -> None:
    picture = shot.pictures[camera]
    height, width, _ = picture.shape
    header = {"camera": camera, "number": shot.number, "time_ns": shot.time_ns, "sim_time": shot.sim_time}
    pose = shot.T_cam_in_base[camera].ravel().tolist()
    _queue_message(client, {**header, "width": width, "height": height, "T_cam_in_base": pose}, picture.tobytes())


def _queue_message(client: ClientConnection, answer: dict[str, Any], data: bytes = b"") -> None:
    head = json.dumps({**answer, "bytes": len(data)}).encode()
    client.outgoing += len(head).to_bytes(4, "little") + head + data


def _next_request(client: ClientConnection) -> dict[str, Any] | None:
    received = client.received
    if len(received) < 4:
        return None
    length = int.from_bytes(received[:4], "little")
    if not 2 <= length <= _MAX_REQUEST_BYTES:
        raise _InvalidRequestError(f"a message of {length} bytes")
    if len(received) < 4 + length:
        return None
    try:
        request = json.loads(bytes(received[4 : 4 + length]))
    # Nested brackets may raise a RecursionError.
    except (ValueError, RecursionError) as error:
        raise _InvalidRequestError("a message that is not JSON") from error
    if not isinstance(request, dict):
        raise _InvalidRequestError("a message that is not an object")
    del received[: 4 + length]
    return request
