"""Real time: programs are answered while physics goes on, and none can stop it."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.serve.can_bus import UnixBus
from yamsim_cli.real.serve.realtime_loop import RealtimeLoop
from yamsim_cli.real.serve.served_arms import serve_arms

ENABLE = struct.pack("=IB3x8s", 1, 8, b"\xff" * 7 + b"\xfc")


@pytest.fixture
def loop(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path, request: pytest.FixtureRequest
) -> RealtimeLoop:
    served = serve_arms(Session(make_config({("rig",): "yam_v1+linear_4310"}), locations))
    bus = UnixBus(tmp_path / "buses", "can0")
    request.addfinalizer(bus.close)
    return RealtimeLoop(served.motor_simulation, [bus], 571e-6)


def beside(loop: RealtimeLoop, seconds: float, work: Callable[[socket.socket], None], folder: Path) -> None:
    """Run the loop while a program works on its bus."""

    def program() -> None:
        with socket.socket(socket.AF_UNIX) as one:
            one.settimeout(5)
            one.connect(str(folder / "buses" / "can0"))
            work(one)

    thread = threading.Thread(target=program)
    thread.start()
    # Until all that it said has been heard, and it is gone.
    loop.run(lambda: not thread.is_alive() and not loop.sockets[0].clients, seconds)
    thread.join()


def test_a_program_is_answered_at_the_buses_pace(loop: RealtimeLoop, tmp_path: Path) -> None:
    got = []

    def ask(one: socket.socket) -> None:
        for _ in range(200):
            one.sendall(ENABLE)
            got.append(one.recv(16))

    beside(loop, 20, ask, tmp_path)
    assert len(got) == 200 and {answer[0] for answer in got} == {0x11}
    pace = loop.timing_stats
    assert pace.frames == 200 and pace.dropped == 0
    # At least that many gaps, less the lag that a late program may catch up.
    assert pace.seconds >= (200 - 8) * 571e-6


def test_a_flood_fills_no_queue_and_stops_no_physics(loop: RealtimeLoop, tmp_path: Path) -> None:
    def flood(one: socket.socket) -> None:
        for _ in range(100):
            one.sendall(ENABLE * 200)

    beside(loop, 20, flood, tmp_path)
    assert loop.timing_stats.dropped > 10_000
    assert len(loop.answers) <= 64
    assert loop.timing_stats.steps > 0
