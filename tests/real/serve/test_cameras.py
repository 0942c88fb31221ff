"""Pictures on a socket, and their reader."""

from __future__ import annotations

import json
import random
import resource
import select
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.real.serve.shots import SIZE, FakeRenderProcess
from yamsim_cli.camera_reader import CameraReader, served_cameras
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.real.motors.motor_bus import BusFault
from yamsim_cli.real.serve.cameras import CameraServer


@pytest.fixture
def shots() -> FakeRenderProcess:
    return FakeRenderProcess()


@pytest.fixture
def server(shots: FakeRenderProcess, tmp_path: Path) -> Iterator[CameraServer]:
    made = CameraServer(tmp_path / "served", shots)  # type: ignore[arg-type]
    yield made
    made.close()


@pytest.fixture
def goes_on(server: CameraServer) -> Iterator[None]:
    """The server works in a thread meanwhile."""
    over = threading.Event()

    def work() -> None:
        while not over.is_set():
            turn(server, 0.005)

    thread = threading.Thread(target=work)
    thread.start()
    yield
    over.set()
    thread.join()


def turn(server: CameraServer, wait: float = 0.0) -> None:
    server.flush()
    ready = select.select(server.readers, server.writers, [], wait)[0]
    server.handle(set(ready))


def join(server: CameraServer) -> socket.socket:
    one = socket.socket(socket.AF_UNIX)
    one.settimeout(5)
    one.connect(str(server.path))
    return one


def said(message: Any) -> bytes:
    data = message if isinstance(message, bytes) else json.dumps(message).encode()
    return len(data).to_bytes(4, "little") + data


@pytest.mark.usefixtures("goes_on")
def test_a_reader_gets_each_camera_and_waits_for_the_next_picture(
    server: CameraServer, shots: FakeRenderProcess
) -> None:
    shots.take(3)
    assert list(served_cameras(server.path.parent)) == ["top", "left"]
    with CameraReader("left", server.path.parent) as reader:
        assert (reader.form.width, reader.form.height, reader.form.fps) == (*SIZE, 30.0)
        first = reader.read()
        assert first.number == 3
        assert first.image.shape == (6, 8, 3) and (first.image == 3).all()
        assert reader.read().number == 3
        timer = threading.Timer(0.05, lambda: shots.take(4))
        timer.start()
        assert reader.read(after=3).number == 4
        with pytest.raises(TimeoutError):
            reader.read(after=4, timeout=0.02)
        # The earlier answer is not taken for the new one.
        shots.take(5)
        assert reader.read(after=-1).number == 5


@pytest.mark.usefixtures("goes_on")
def test_another_camera_or_no_server_is_one_line(server: CameraServer, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"there is no camera 'right'; .*top"):
        CameraReader("right", server.path.parent)
    with pytest.raises(ResourceError, match=r"no cameras are served there .*serve-robot --cameras"):
        CameraReader("top", tmp_path)


def test_a_wrong_question_is_told_and_the_next_is_answered(server: CameraServer, shots: FakeRenderProcess) -> None:
    shots.take(0)
    one = join(server)
    for wrong in ({"ask": "film"}, {"ask": "picture", "camera": ["top"]}, {"ask": "picture", "after": "1"}, {}):
        one.sendall(said(wrong))
        for _ in range(3):
            turn(server, 0.05)
        length = int.from_bytes(one.recv(4), "little")
        assert "error" in json.loads(one.recv(length))
    one.sendall(said({"ask": "picture", "camera": "top"}))
    for _ in range(3):
        turn(server, 0.05)
    length = int.from_bytes(one.recv(4), "little")
    assert json.loads(one.recv(length))["bytes"] == 3 * 6 * 8


@pytest.mark.parametrize("noise", [(2**31).to_bytes(4, "little"), said(b"[" * 4000), said(b"\xff\xfe"), said([1])])
def test_a_client_with_an_invalid_message_is_dropped(server: CameraServer, noise: bytes) -> None:
    one = join(server)
    one.sendall(noise)
    for _ in range(3):
        turn(server, 0.05)
    assert one.recv(8) == b""


def test_a_client_that_reads_nothing_waits_and_fills_no_memory(server: CameraServer, shots: FakeRenderProcess) -> None:
    shots.size = (640, 480)
    shots.take(0)
    one = join(server)
    one.sendall(said({"ask": "picture", "camera": "top"}) * 60)
    for _ in range(100):
        turn(server)
    waits = [len(client.outgoing) for client in server.clients]
    assert waits and max(waits) < 2 * 3 * 640 * 480
    other = join(server)
    other.sendall(said({"ask": "cameras"}))
    for _ in range(3):
        turn(server, 0.05)
    assert other.recv(4)


def test_10000_random_messages_do_no_harm(server: CameraServer, shots: FakeRenderProcess) -> None:
    draw = random.Random(7)
    shots.take(0)
    whole = json.dumps({"ask": "picture", "camera": "top", "after": -1}).encode()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    one = join(server)
    for k in range(10_000):
        noise = bytearray(whole)
        for _ in range(draw.randrange(1, 6)):
            noise[draw.randrange(len(noise))] = draw.randrange(256)
        body = bytes(noise) if k % 2 else draw.randbytes(draw.randrange(2, 200))
        try:
            one.sendall(said(body) if k % 499 else draw.randbytes(24))
        except OSError:
            one = join(server)
        turn(server)
        while select.select([one], [], [], 0)[0]:
            if not one.recv(65_536):
                one = join(server)
                break
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000
    last = join(server)
    last.sendall(said({"ask": "cameras"}))
    for _ in range(4):
        turn(server, 0.05)
    assert last.recv(4)


def _head(**told: Any) -> bytes:
    return said(
        {"width": 8, "height": 6, "number": 1, "time_ns": 1, "sim_time": 0.0, "T_cam_in_base": [0.0] * 16} | told
    )


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ((2**32 - 1).to_bytes(4, "little"), "this server is not `yamsim serve-robot`$"),
        (said(b"[1"), "its answer is not valid"),
        (said([1]), "this server is not `yamsim serve-robot`$"),
        (said({"bytes": 2**40}), "this server is not `yamsim serve-robot`$"),
        (_head(bytes=3, width=1, height=1) + b"abc", "the size of its pictures has changed"),
        (_head(bytes=144, number="x") + bytes(144), "is another version of it"),
        (_head(bytes=144, T_cam_in_base=[1]) + bytes(144), "is another version of it"),
        (said({"bytes": 10}) + b"abc", "has ended"),
    ],
)
def test_a_lying_server_is_found_out(answer: bytes, says: str, tmp_path: Path) -> None:
    folder = tmp_path / "liar"
    folder.mkdir()
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(folder / "cameras.sock"))
    listener.listen()
    one = {"width": 8, "height": 6, "fps": 1, "K": [1.0] * 9}

    def lie() -> None:
        for told in (said({"cameras": {"top": one}, "bytes": 0}), answer):
            peer, _ = listener.accept()
            peer.recv(4096)
            peer.sendall(told)
            peer.close()

    thread = threading.Thread(target=lie)
    thread.start()
    reader = CameraReader("top", folder)
    with pytest.raises(ResourceError, match=says):
        reader.read()
    reader.close()
    thread.join()
    listener.close()


def test_a_silent_camera_sends_nothing_for_a_time(shots: FakeRenderProcess, tmp_path: Path) -> None:
    fault = BusFault("silent", start_time=1.0, seconds=2.0, camera="top")
    server = CameraServer(tmp_path / "served", shots, [fault])  # type: ignore[arg-type]
    try:
        for number, (sim_time, answered) in enumerate(((0.9, True), (1.0, False), (2.9, False), (3.0, True))):
            shots.take(number, sim_time)
            for camera, wanted in (("top", answered), ("left", True)):
                with join(server) as client:
                    client.sendall(said({"ask": "picture", "camera": camera}))
                    for _ in range(3):
                        turn(server, 0.01)
                    assert bool(select.select([client], [], [], 0)[0]) is wanted
    finally:
        server.close()
    with pytest.raises(UsageError, match=r"no camera 'upper'; valid: top, left"):
        CameraServer(tmp_path / "other", shots, [BusFault("silent", camera="upper")])  # type: ignore[arg-type]
