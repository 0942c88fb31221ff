"""The maker's station programs on `yamsim serve-robot`, started by `yamsim-maker`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.clients.environments import REPOSITORY, SCRIPTS, Interpreter, checkout
from tests.clients.served_robot import ServedRobot

RIG = "yam_station_linear_4310_d405"
SIZE = (160, 120)  # px, of small images
SERVED = ("--rig", RIG, "--size", f"{SIZE[0]}x{SIZE[1]}", "--quality", "fast", "--cameras", "--camera-fps", "4")
CHANNELS = ("can_left", "can_right")
PATIENCE_S = 600  # the machine may be busy
_INTEGRATION = REPOSITORY / "integrations" / "maker_station_yamsim"


def write_station(folder: Path, size: tuple[int, int] = SIZE) -> Path:
    """The integration's station file, for images of another size."""
    station = yaml.safe_load((_INTEGRATION / "station.yaml").read_text(encoding="utf-8"))
    for camera in station["cameras"]:
        camera |= {"width": size[0], "height": size[1]}
    path = folder / "station.yaml"
    path.write_text(yaml.safe_dump(station), encoding="utf-8")
    return path


@contextmanager
def maker_program(
    interpreter: Interpreter, served: ServedRobot, folder: Path, *arguments: object, script: str = "maker_program.py"
) -> Iterator[subprocess.Popen[str]]:
    """Run a program in `folder`, and interrupt it at the end if it still runs; its output is in `output.txt`."""
    launcher = [sys.executable, "-m", "maker_station_yamsim", "--folder", str(served.folder)]
    program = [str(interpreter.python), str(SCRIPTS / script), str(checkout("YAMSIM_MAKER"))]
    path = os.pathsep.join([str(REPOSITORY), str(_INTEGRATION)])
    with (
        (folder / "output.txt").open("w", encoding="utf-8") as output,
        subprocess.Popen(
            [*launcher, *program, *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"},
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process,
    ):
        try:
            yield process
        finally:
            # The SDK's threads keep a program alive after its own end, so an interrupt may not be enough.
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(20)
            process.kill()


def wait_until(folder: Path, holds: Callable[[], bool]) -> None:
    """Wait until a condition of a program in `folder` holds; skip the test if the machine is too busy for the SDK."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        said = (folder / "output.txt").read_text(encoding="utf-8")
        skip_if_too_busy(said)
        assert time.monotonic() < end, said[-2000:]
        time.sleep(0.2)


def wait_for_output(folder: Path, text: str) -> str:
    """Return the output of a program in `folder` once it has a text."""
    wait_until(folder, lambda: text in (folder / "output.txt").read_text(encoding="utf-8"))
    return (folder / "output.txt").read_text(encoding="utf-8")


def skip_if_too_busy(said: str) -> None:
    """Skip a test whose program says that the SDK, which waits some ms for an answer, has lost its motors."""
    if "fail to communicate with the motor" in said or "error: loss communication" in said:
        pytest.skip("the machine is too busy for the SDK's control loop: it lost motors without a fault")


class MakerGui:
    """Requests to `yam-abc-gui` on a port, whose output is in a folder."""

    def __init__(self, port: int, process: subprocess.Popen[str], folder: Path) -> None:
        self.port, self._process, self._folder = port, process, folder

    def ask(self, path: str, body: dict[str, Any] | None = None, method: str = "GET") -> Any:
        """Return the JSON of an answer; that of a refusal has the key `detail`."""
        data = None if body is None else json.dumps(body).encode()
        head = {"Content-Type": "application/json"}
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", data, head, method=method)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            return json.load(error)

    def post(self, path: str, body: dict[str, Any] | None = None) -> Any:
        return self.ask(path, body, "POST")

    def start(self, what: str, body: dict[str, Any] | None = None) -> None:
        """Start `collect/start-teleop` or `deploy/start`, which builds the arms."""
        answer = self.post(f"/api/{what}", body)
        skip_if_too_busy(str(answer))
        assert "detail" not in answer, answer

    def status_when(self, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return the first status of its websocket for which a condition holds."""
        from websockets.sync.client import connect

        end = time.monotonic() + PATIENCE_S
        with connect(f"ws://127.0.0.1:{self.port}/ws", open_timeout=PATIENCE_S, max_size=None) as feed:
            while time.monotonic() < end:
                status: dict[str, Any] = json.loads(feed.recv(PATIENCE_S))
                if holds(status):
                    return status
                skip_if_too_busy((self._folder / "output.txt").read_text(encoding="utf-8"))
        raise AssertionError(f"the GUI did not get there: {status}")

    def is_up(self) -> bool:
        assert self._process.poll() is None, "the GUI has ended"
        try:
            return "version" in self.ask("/api/health")
        except OSError:
            return False


@contextmanager
def maker_gui(
    interpreter: Interpreter,
    served: ServedRobot,
    folder: Path,
    size: tuple[int, int] = SIZE,
    times: Path | None = None,
) -> Iterator[MakerGui]:
    """Run `yam-abc-gui`, from its first answer on.

    Args:
        times: where `maker_collects.py` writes the times of a recording's rows; without, `maker_program.py` runs it.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    script, first = ("maker_collects.py", times) if times else ("maker_program.py", "gui")
    arguments = [first, "--station", write_station(folder, size), "--host", "127.0.0.1", "--port", port]
    with maker_program(interpreter, served, folder, *arguments, script=script) as process:
        gui = MakerGui(port, process, folder)
        end = time.monotonic() + PATIENCE_S
        while not gui.is_up():
            assert time.monotonic() < end, (folder / "output.txt").read_text(encoding="utf-8")
            time.sleep(0.2)
        yield gui


def let_motors_wait(served: ServedRobot, interpreter: Interpreter, channels: Sequence[str] = CHANNELS) -> None:
    """Disable the motors' timeout, which a busy machine would reach."""
    assert served.run(interpreter, "motors_wait.py", *channels) == {"answers": 7 * len(channels)}
