"""Send noise to a running `serve-robot`: 10,000 messages to each port; report its memory, and whether it still answers.

python -m tools.bench.noise [--messages 10000]
"""

from __future__ import annotations

import argparse
import json
import random
import socket
import struct
import tempfile
import time
from pathlib import Path

import msgpack
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.clients.served_robot import ServedRobot, served_robot
from yamsim_cli.camera_reader import CameraReader
from yamsim_cli.real.serve.socket_servers import CAMERA_SOCKET

_ENABLE = struct.pack("=IB3x8s", 1, 8, b"\xff" * 7 + b"\xfc")
_HANDSHAKE = b"portal_handshake"
_SMALL = ("--size", "64x48", "--quality", "fast")


def main() -> None:
    """Make noise, and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=10_000)
    count = parser.parse_args().messages
    told: dict[str, object] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        served_robot(Path(folder) / "buses", "--portal", "0", "--chiral", "0", "--cameras", *_SMALL) as served,
    ):
        draw = random.Random(1)
        kinds = {"can": _can_noise, "portal": _portal_noise, "chiral": _chiral_noise, "cameras": _camera_noise}
        for name, noise in kinds.items():
            # The first tenth fills caches.
            noise(served, draw, count // 10)
            before = _resident_kb(served)
            began = time.monotonic()
            noise(served, draw, count)
            told[name] = {"seconds": time.monotonic() - began, "grown_kb": _resident_kb(served) - before}
        with _bus(served) as one:
            one.sendall(_ENABLE)
            told["answers"] = len(one.recv(16)) == 16
        with CameraReader("scene_camera", served.folder) as reader:
            told["pictures"] = reader.read().image.shape == (48, 64, 3)
        with connect(f"ws://127.0.0.1:{served.chiral}", compression=None) as robot:
            robot.send(_chiral_message({"type": "metadata"}))
            told["metadata"] = len(robot.recv(timeout=10)) > 100
    print(json.dumps(told | {"server": served.report}, indent=2))


def _bus(served: ServedRobot) -> socket.socket:
    one = socket.socket(socket.AF_UNIX)
    one.settimeout(10)
    one.connect(str(served.folder / "can0"))
    return one


def _can_noise(served: ServedRobot, draw: random.Random, count: int) -> None:
    with _bus(served) as one:
        for k in range(count):
            one.sendall(draw.randbytes(16) if k % 3 else struct.pack("=IB3x8s", 0x7FF, 8, draw.randbytes(8)))


def _portal_noise(served: ServedRobot, draw: random.Random, count: int) -> None:
    one = None
    for k in range(count):
        if one is None:
            one = socket.create_connection(("127.0.0.1", served.ports[0]), timeout=10)
            one.sendall(_HANDSHAKE)
        body = draw.randbytes(draw.randrange(1, 200))
        try:
            one.sendall(len(body).to_bytes(8, "little") + body if k % 100 else draw.randbytes(50))
        except OSError:
            one.close()
            one = None
            continue
        one.setblocking(False)
        try:
            one.recv(65_536)
        except BlockingIOError:
            pass
        except OSError:
            one.close()
            one = None
            continue
        one.setblocking(True)


def _chiral_message(header: dict[str, object], data: bytes = b"") -> bytes:
    head = msgpack.packb(header)
    return len(head).to_bytes(4, "little") + head + data


def _chiral_noise(served: ServedRobot, draw: random.Random, count: int) -> None:
    whole = _chiral_message({"type": "apply_action", "shape": [7], "dtype": "float32"}, bytes(28))
    robot = None
    for k in range(count):
        if robot is None:
            robot = connect(f"ws://127.0.0.1:{served.chiral}", compression=None)
        noise = bytearray(whole) if k % 2 else bytearray(draw.randbytes(draw.randrange(1, 200)))
        noise[draw.randrange(len(noise))] = draw.randrange(256)
        try:
            robot.send(bytes(noise))
        except ConnectionClosed:
            robot = None
    if robot is not None:
        robot.close()


def _camera_noise(served: ServedRobot, draw: random.Random, count: int) -> None:
    one = None
    for k in range(count):
        if one is None:
            one = socket.socket(socket.AF_UNIX)
            one.settimeout(10)
            one.connect(str(served.folder / CAMERA_SOCKET))
        body = draw.randbytes(draw.randrange(2, 200))
        try:
            one.sendall(len(body).to_bytes(4, "little") + body if k % 100 else draw.randbytes(50))
        except OSError:
            one.close()
            one = None
    if one is not None:
        one.close()


def _resident_kb(served: ServedRobot) -> int:
    text = Path(f"/proc/{served.process}/status").read_text()
    return int(next(line.split()[1] for line in text.splitlines() if line.startswith("VmRSS")))


if __name__ == "__main__":
    main()
