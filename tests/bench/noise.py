"""Noise against a running `serve-robot`: 10,000 messages to each port, what its memory does, whether it still answers.

python -m tests.bench.noise [--messages 10000]
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

from tests.clients.served_robot import ServedRobot, served_robot

_ENABLE = struct.pack("=IB3x8s", 1, 8, b"\xff" * 7 + b"\xfc")
_HANDSHAKE = b"portal_handshake"


def main() -> None:
    """Make noise, and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=10_000)
    count = parser.parse_args().messages
    told: dict[str, object] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        served_robot(Path(folder) / "buses", "--portal", "0") as served,
    ):
        draw = random.Random(1)
        for name, noise in (("can", _can_noise), ("portal", _portal_noise)):
            # The first tenth fills what is kept for good.
            noise(served, draw, count // 10)
            before = _resident_kb(served)
            began = time.monotonic()
            noise(served, draw, count)
            told[name] = {"seconds": time.monotonic() - began, "grown_kb": _resident_kb(served) - before}
        with _bus(served) as one:
            one.sendall(_ENABLE)
            told["answers"] = len(one.recv(16)) == 16
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


def _resident_kb(served: ServedRobot) -> int:
    text = Path(f"/proc/{served.process}/status").read_text()
    return int(next(line.split()[1] for line in text.splitlines() if line.startswith("VmRSS")))


if __name__ == "__main__":
    main()
