"""The launcher and its adapters, on a bus and cameras without a simulation."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.real.serve.shots import FakeRenderProcess
from yamsim_cli.real.serve.cameras import CameraServer
from yamsim_cli.real.serve.can_bus import UnixBus

REPOSITORY = Path(__file__).resolve().parents[3]
_PATH = os.pathsep.join([str(REPOSITORY), str(Path(__file__).resolve().parents[1])])

_READS = """
import json, sys
import pyrealsense2 as rs
said = {"devices": [one.get_info(rs.camera_info.serial_number) for one in rs.context().query_devices()]}
def opened(serial, width, form=rs.format.rgb8):
    wanted, pipe = rs.config(), rs.pipeline()
    wanted.enable_device(serial)
    wanted.enable_stream(rs.stream.color, width, 6, form, 30)
    pipe.start(wanted)
    return pipe
pipe = opened("left", 8)
image = pipe.wait_for_frames().get_color_frame().get_data()
said["image"] = [list(image.shape), int(image.min()), int(image.max())]
for name, act in (
    ("late", lambda: pipe.wait_for_frames(50)),
    ("size", lambda: opened("left", 9)),
    ("depth", lambda: opened("left", 8, rs.format.z16)),
    ("serial", lambda: opened("128422272025", 8)),
):
    try:
        act()
    except RuntimeError as error:
        said[name] = str(error)
pipe.stop()
said["ip"] = __import__("subprocess").run(["ip", "link", "show", "can_left"], capture_output=True, text=True).stdout
print(json.dumps(said))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A bus `can_left`, and cameras with one image."""
    where, over, shots = tmp_path / "served", threading.Event(), FakeRenderProcess()
    bus = UnixBus(where, "can_left")
    server = CameraServer(where, shots)  # type: ignore[arg-type]
    shots.take(7)

    def work() -> None:
        while not over.is_set():
            server.flush()
            server.handle(set(select.select(server.readers, server.writers, [], 0.005)[0]))

    thread = threading.Thread(target=work)
    thread.start()
    yield where
    over.set()
    thread.join()
    server.close()
    bus.close()


def launched(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "maker_station_yamsim", *map(str, arguments)]
    return subprocess.run(
        command, env={**os.environ, "PYTHONPATH": _PATH}, capture_output=True, text=True, check=False, timeout=120
    )


def test_a_program_finds_cameras_and_buses(folder: Path) -> None:
    done = launched("--folder", folder, sys.executable, "-c", _READS)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["devices"] == ["top", "left"]
    assert said["image"] == [[6, 8, 3], 7, 7]
    assert said["late"].startswith("Frame didn't arrive within 50")
    assert said["size"].startswith("Couldn't resolve requests (color rgb8 9x6; yamsim serves color rgb8 8x6")
    assert said["depth"].startswith("Couldn't resolve requests (color z16 8x6")
    assert said["serial"].startswith("No device connected (serial '128422272025'; yamsim serves top, left")
    assert "can_left: <NOARP,UP,LOWER_UP>" in said["ip"] and "state UNKNOWN" in said["ip"]


def test_without_a_server_or_a_program_it_says_so(tmp_path: Path) -> None:
    done = launched("--folder", tmp_path, "true")
    assert (done.returncode, "no server runs there" in done.stderr) == (4, True)
    done = launched()
    assert (done.returncode, "give a program" in done.stderr) == (2, True)


def test_an_unknown_program_is_named(folder: Path) -> None:
    done = launched("--folder", folder, "yam-abc-guy")
    assert done.returncode == 2 and "yam-abc-guy: cannot be run: No such file" in done.stderr
