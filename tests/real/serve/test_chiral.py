"""chiral's messages: read and answered as its own client packs them, and nothing else is accepted."""

from __future__ import annotations

import logging
import random
import resource
import select
import socket
import time
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
from websockets.client import ClientProtocol
from websockets.frames import Frame, Opcode
from websockets.uri import parse_uri

from tests.real.serve.shots import FakeRenderProcess
from yamsim_cli.real.serve import chiral
from yamsim_cli.real.serve.chiral import ChiralError, ChiralServer, read_message
from yamsim_cli.real.serve.policy_robot import CameraView, RobotObservation


class Robot:
    """A robot that only records its calls."""

    metadata = {"action_shape": [20]}  # noqa: RUF012
    is_going_home = False
    sim_time = 0.0
    stop_reason = ""

    def __init__(self) -> None:
        self.shots = FakeRenderProcess()
        self.told: list[np.ndarray] = []
        self.resets = 0

    @property
    def camera_frames(self) -> Any:
        return self.shots.newest_frames

    def queue_action(self, numbers: np.ndarray) -> None:
        if numbers.shape != (20,) or not np.isfinite(numbers).all():
            raise ValueError("an action has 20 numbers")
        self.told.append(numbers)

    def reset(self) -> None:
        self.resets += 1
        self.stop_reason = ""

    def stop(self, why: str) -> None:
        self.stop_reason = why

    def observe(self, shot: Any) -> RobotObservation:
        view = CameraView(shot.pictures["top"], np.eye(3), np.eye(4), shot.time_ns)
        return RobotObservation(
            {"top": view}, {"follower_l_joint_pos": np.arange(7.0)}, 1.5, {"sim_time": shot.sim_time}
        )


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def server(robot: Robot) -> Iterator[ChiralServer]:
    made = ChiralServer(robot, "127.0.0.1", 0)  # type: ignore[arg-type]
    yield made
    made.close()


def turn(server: ChiralServer, times: int = 3, wait: float = 0.02) -> None:
    for _ in range(times):
        server.flush()
        server.handle(set(select.select(server.readers, [], [], wait)[0]))
    server.flush()


class Client:
    """A non-blocking WebSocket: it sends frames, and reads arrived ones."""

    def __init__(self, server: ChiralServer, **headers: str) -> None:
        self.socket = socket.create_connection(("127.0.0.1", server.port), timeout=5)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._protocol = ClientProtocol(parse_uri("ws://localhost/"), max_size=None, logger=logging.getLogger("quiet"))
        request = self._protocol.connect()
        for name, value in headers.items():
            request.headers[name] = value
        self._protocol.send_request(request)
        self.flush()
        until = time.monotonic() + 5
        self.events: list[Any] = []
        while not self.events and time.monotonic() < until:
            turn(server, times=1, wait=0.001)
            self.events = self.heard()

    def flush(self) -> None:
        self.socket.sendall(b"".join(self._protocol.data_to_send()))

    def send(self, message: bytes) -> None:
        self._protocol.send_binary(message)
        self.flush()

    def heard(self) -> list[Any]:
        while select.select([self.socket], [], [], 0.001)[0]:
            try:
                data = self.socket.recv(65_536)
            except ConnectionResetError:
                data = b""
            if not data:
                self._protocol.receive_eof()
                break
            self._protocol.receive_data(data)
        return self._protocol.events_received()

    @property
    def code(self) -> int | None:
        return self._protocol.close_code


def packed(header: Any, data: bytes = b"") -> bytes:
    head = msgpack.packb(header)
    return len(head).to_bytes(4, "little") + head + data


def action(numbers: Any, dtype: str = "float32", **header: Any) -> bytes:
    values = np.asarray(numbers, dtype)
    return packed({"type": "apply_action", "shape": list(values.shape), "dtype": dtype, **header}, values.tobytes())


def messages(client: Client) -> list[tuple[dict[str, Any], bytes]]:
    found = []
    for event in client.heard():
        if isinstance(event, Frame) and event.opcode is Opcode.BINARY:
            length = int.from_bytes(event.data[:4], "little")
            found.append((msgpack.unpackb(event.data[4 : 4 + length]), bytes(event.data[4 + length :])))
    return found


def test_it_tells_what_it_is_and_what_it_sees_in_the_order_of_questions(server: ChiralServer, robot: Robot) -> None:
    robot.shots.take(9, sim_time=2.0)
    one = Client(server)
    for kind in ("metadata", "obs_request", "metadata"):
        one.send(packed({"type": kind}))
    turn(server)
    told = messages(one)
    assert [head["type"] for head, _ in told] == ["metadata_response", "obs_response", "metadata_response"]
    assert told[0][0]["data"] == {"action_shape": [20]}
    head, data = told[1]
    (camera,) = head["cameras"]
    start, size = camera["image_offset"], camera["image_size"]
    assert camera["image_shape"] == [6, 8, 3] and data[start : start + size] == b"\x09" * 144
    (proprio,) = head["proprios"]
    felt = np.frombuffer(data[proprio["offset"] : proprio["offset"] + proprio["size"]], proprio["dtype"])
    np.testing.assert_equal(felt, np.arange(7.0))
    assert head["extra"] == {"sim_time": 2.0}


def test_a_reset_is_answered_when_the_arms_are_home_and_seen_there(server: ChiralServer, robot: Robot) -> None:
    robot.shots.take(0, sim_time=1.0)
    robot.is_going_home, robot.sim_time = True, 3.0
    one = Client(server)
    one.send(packed({"type": "reset"}))
    turn(server)
    assert messages(one) == [] and robot.resets == 1
    robot.is_going_home = False
    turn(server)
    assert messages(one) == []  # The newest pictures are from before.
    robot.shots.take(1, sim_time=3.1)
    turn(server)
    ((head, _),) = messages(one)
    assert head["type"] == "reset_response" and head["info"] == {}


@pytest.mark.parametrize("dtype", ["float32", "float64", "float16"])
def test_actions_are_taken_and_the_arms_stop_when_who_sent_them_goes(
    server: ChiralServer, robot: Robot, dtype: str
) -> None:
    one = Client(server)
    one.send(action(np.full(20, 0.5), dtype, obs_timestamps={"top": 1.0}))
    one.send(action(np.ones((1, 20)), dtype))
    turn(server)
    np.testing.assert_equal(robot.told, [np.full(20, 0.5), np.ones(20)])
    one.socket.close()
    turn(server)
    assert "has disconnected" in robot.stop_reason


def test_a_client_without_actions_may_disconnect(server: ChiralServer, robot: Robot) -> None:
    robot.shots.take(0)
    one = Client(server)
    one.send(packed({"type": "obs_request"}))
    turn(server)
    one.socket.close()
    turn(server)
    assert robot.stop_reason == ""


@pytest.mark.parametrize(
    "wrong",
    [
        b"",
        b"\xff" * 4,
        packed([1]),
        packed({"type": "jump"}),
        packed({"type": ["reset"]}),
        action(np.ones(20), "int64"),
        packed({"type": "apply_action", "shape": [20], "dtype": "O"}, bytes(160)),
        packed({"type": "apply_action", "shape": [2**40], "dtype": "float32"}, bytes(80)),
        packed({"type": "apply_action", "shape": [-20], "dtype": "float32"}, bytes(80)),
        packed({"type": "apply_action", "shape": [], "dtype": "float32"}, bytes(4)),
        packed({"type": "apply_action", "shape": [21], "dtype": "float32"}, bytes(80)),
        packed({"type": "apply_action", "shape": [257], "dtype": "float32"}, bytes(4 * 257)),
    ],
)
def test_invalid_messages_are_refused(wrong: bytes) -> None:
    with pytest.raises(ChiralError):
        read_message(wrong)


@pytest.mark.parametrize(
    "wrong", [packed({"type": "jump"}), action(np.ones(3)), action(np.full(20, np.nan)), b"\xff" * 9]
)
def test_a_wrong_message_costs_the_connection_alone(server: ChiralServer, robot: Robot, wrong: bytes) -> None:
    one, other = Client(server), Client(server)
    one.send(wrong)
    turn(server)
    one.heard()
    assert one.code == 1008
    other.send(packed({"type": "metadata"}))
    turn(server)
    assert messages(other)
    assert robot.told == []


def test_a_client_with_too_long_a_message_is_dropped(server: ChiralServer) -> None:
    one = Client(server)
    one.send(bytes(chiral.MAX_MESSAGE_BYTES + 1))
    turn(server)
    one.heard()
    assert one.code in (1006, 1009)  # it may be gone before the message
    assert not server.clients


@pytest.mark.parametrize("foreign", [{"Origin": "http://elsewhere"}, {"Origin": "null"}, {"Host": "elsewhere:80"}])
def test_web_pages_are_refused(server: ChiralServer, foreign: dict[str, str]) -> None:
    page = Client(server, **foreign)
    (answer,) = page.events
    assert answer.status_code == 403
    assert not select.select([page.socket], [], [], 0)[0] or page.socket.recv(1) == b""


def test_a_client_without_a_handshake_is_dropped(server: ChiralServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chiral, "HANDSHAKE_SECONDS", 0.05)
    one = socket.create_connection(("127.0.0.1", server.port), timeout=5)
    one.sendall(b"GET / HTTP/1.1\r\n")
    turn(server)
    time.sleep(0.06)
    turn(server)
    assert one.recv(1) == b""


def test_a_client_that_reads_nothing_waits_and_fills_no_memory(server: ChiralServer, robot: Robot) -> None:
    robot.shots.size = (640, 480)
    robot.shots.take(0)
    one = Client(server)
    for _ in range(100):
        one.send(packed({"type": "obs_request"}))
    turn(server, times=50, wait=0.0)
    waits = [len(client.outgoing) for client in server.clients]
    assert waits and max(waits) < 2 * 3 * 640 * 480


def test_a_flooding_client_is_dropped(server: ChiralServer, robot: Robot) -> None:
    one = Client(server)
    # No picture comes, so that the first of them is never answered.
    for _ in range(chiral.MAX_QUEUED + 50):
        one.send(packed({"type": "obs_request"}))
    turn(server, times=20)
    one.heard()
    assert one.code == 1008


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_random_messages_do_no_harm_and_fill_no_memory(server: ChiralServer, robot: Robot, count: int) -> None:
    """Most are framed correctly, so that all parts of the reader are reached."""
    draw = random.Random(7)
    robot.shots.take(0)
    whole = action(np.ones(20))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    one = Client(server)
    for k in range(count):
        noise = bytearray(whole)
        for _ in range(draw.randrange(1, 6)):
            noise[draw.randrange(len(noise))] = draw.randrange(256)
        try:
            if k % 499:
                one.send(bytes(noise) if k % 2 else draw.randbytes(draw.randrange(1, 200)))
            else:
                one.socket.sendall(draw.randbytes(24))
        except OSError:
            one = Client(server)
        server.handle(set(select.select(server.readers, [], [], 0)[0]))
        server.flush()
        if select.select([one.socket], [], [], 0)[0]:
            one.heard()
            if one.code is not None:
                one.socket.close()
                one = Client(server)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000
    last = Client(server)
    last.send(packed({"type": "metadata"}))
    turn(server)
    assert messages(last)
