"""The maker's yam-abc-gui and yam-abc-deploy, unmodified, on simulated arms, leaders and cameras.

`YAMSIM_MAKER` names a checkout of i2rt-robotics/yam-abc-reproduce, without its submodules.
"""

from __future__ import annotations

import re
import signal
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.clients.environments import Interpreter
from tests.clients.maker_station import (
    PATIENCE_S,
    SERVED,
    let_motors_wait,
    maker_gui,
    maker_program,
    wait_for_output,
    wait_until,
    write_station,
)
from tests.clients.served_robot import served_robot
from tests.export.real_datasets import bring_in
from tests.export.station_datasets import motion_at, station_dataset
from tests.policies.servers import openpi_server
from tests.real.recordings.foreign import shares
from yamsim_cli.camera_reader import CameraReader
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.openpi import pack_openpi, unpack_openpi
from yamsim_cli.real.recordings.motion_reading import read_motions

pytestmark = [pytest.mark.client, pytest.mark.render]
pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
pytest.importorskip("websockets", reason="yamsim[remote] is not installed")

FRAMES = 60  # two seconds of motion
ROLES = ("top", "left", "right")
GOAL = np.array([0.3, 1.1, 1.2, -0.2, 0.1, 0.2, 0.5] * 2, np.float32)
HOLD_S = 3.0  # s of a dead server, several chunks
STOP_AT_S = 45  # simulated s at which a camera stops; by then the program shows its first images
REQUESTS = 8  # with the same image, after which a camera counts as stopped: 4 s and more
ROW_RAD = 0.03  # of a server's plans, less than the program's limit of 0.05 rad an action


class Planner:
    """Plans 19 actions towards `GOAL`, after the prefix if there is one; fails from a number of requests on."""

    def __init__(self, requests: int = 1_000_000) -> None:
        self.asked: list[Mapping[str, Any]] = []
        self.last = GOAL
        self.arrived, self.died = threading.Event(), threading.Event()
        self._requests = requests

    def __call__(self, data: bytes) -> bytes:
        if len(self.asked) == self._requests:
            self.died.set()
            raise ConnectionResetError("the server has died")
        message = unpack_openpi(data)
        self.asked.append(message)
        if np.abs(message["state"] - GOAL).max() < 0.1:
            self.arrived.set()
        rows = list(message.get("action_prefix", [message["state"]]))
        goal = self.goal()
        for _ in range(19):
            rows.append(rows[-1] + np.clip(goal - rows[-1], -ROW_RAD, ROW_RAD).astype(np.float32))
        actions = np.array(rows[len(rows) - 19 :] if "action_prefix" not in message else rows)
        # With real-time chunking the program executes 15 rows after the prefix of 4, and otherwise 15 rows.
        self.last = actions[18 if "action_prefix" in message else 14]
        return pack_openpi({"actions": actions})

    def goal(self) -> np.ndarray:
        return GOAL


class Swinger(Planner):
    """Turns both arms to and fro without end, so that all images change."""

    def goal(self) -> np.ndarray:
        goal = GOAL.copy()
        goal[[0, 7]] += 0.4 * (-1) ** (len(self.asked) // 4)
        return goal

    def images_of(self, role: str, requests: int) -> int:
        """How many different images of a camera the last requests had."""
        return len({message["images"][role].tobytes() for message in self.asked[-requests:]})


METADATA = pack_openpi({"state_dim": 14})


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Path:
    dataset = station_dataset(tmp_path_factory.mktemp("leader"), [motion_at(station, FRAMES)], station, locations)
    return dataset / "ep_000000"


def distance_to_path(rows: np.ndarray, path: np.ndarray) -> float:
    """Largest distance of a row (n, 7) from the nearest point of the path (m, 7) between its points."""
    fine = np.arange(0, len(path) - 1 + 1e-9, 0.02)
    dense = np.column_stack([np.interp(fine, np.arange(len(path)), column) for column in path.T])
    return max(float(np.abs(dense - row).max(axis=1).min()) for row in rows)


def test_the_gui_collects_an_episode_that_the_leaders_perform(
    client: Callable[[str], Interpreter], episode: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    program = client("maker-station")
    _, commanded = shares(motion_at(station, FRAMES), station)
    with served_robot(tmp_path / "buses", *SERVED, "--leader", str(episode)) as served:
        let_motors_wait(served, program)
        with maker_gui(program, served, tmp_path) as gui:
            gui.start("collect/start-teleop")
            found = gui.ask("/api/cameras/health?full=1")["cameras"]
            assert [(one["name"], one["detected"], one["streaming"]) for one in found] == [
                (r, True, True) for r in ROLES
            ]
            gui.status_when(lambda status: status["recording"])
            status = gui.status_when(lambda status: status["episodes_done"] == 1)
            assert status["live"] and status["teleop_running"] and status["last_error"] is None
            # The followers arrive where the performance ends.
            gui.status_when(
                lambda status: all(
                    np.abs(np.array(status["arms"][side]["follower"])[:6] - rows[-1, :6]).max() < 0.05
                    for side, rows in zip(("left", "right"), commanded, strict=True)
                )
            )
            (listed,) = gui.ask("/api/review/episodes")["episodes"]
            signals = gui.ask(f"/api/review/{listed['id']}/signals")
            assert gui.post("/api/session/reset")["ok"]
    assert (listed["task_name"], sorted(listed["cameras"])) == ("pick_and_place", sorted(ROLES))
    assert signals["num_frames"] == listed["num_frames"] > 0
    for side, path in zip(("left", "right"), commanded, strict=True):
        arm = signals["arms"][side]
        rows = np.hstack([arm["action_joint"], arm["action_gripper"]])
        # An encoder has 4096 counts a turn; the seven of an arm report within 10 ms, in which a joint moves 0.007 rad.
        assert distance_to_path(rows, path) < 0.03
        assert np.abs(rows[0] - path[0]).max() < 0.03 and np.abs(rows[-1] - path[-1]).max() < 0.03
    # yamsim reads what it collected.
    dataset = bring_in(tmp_path / "real", [tmp_path / "data" / "episodes"], station, locations)
    (motion,) = read_motions([dataset], station, locations)
    assert len(motion.times) == listed["num_frames"]


def test_its_own_tests_pass_where_the_station_takes_the_place_of_devices(
    client: Callable[[str], Interpreter], tmp_path: Path
) -> None:
    """They use arms and cameras of their own, and no bus; the adapters come first on their path."""
    program = client("maker-station")
    # A busy machine does not start its server in the 0.6 s that this file allows.
    flags = ["-q", "-p", "no:cacheprovider", "--deselect", "tests/test_deploy_probe_quiet.py"]
    with (
        served_robot(tmp_path / "buses", *SERVED) as served,
        maker_program(program, served, tmp_path, "tests", *flags) as process,
    ):
        code = process.wait(PATIENCE_S)
    said = (tmp_path / "output.txt").read_text(encoding="utf-8")
    assert code == 0, said[-3000:]
    found = re.search(r"(\d+) passed", said)
    assert found and int(found[1]) > 100, said[-3000:]


@pytest.mark.parametrize("rtc", [False, True], ids=["chunks", "rtc"])
def test_deploy_drives_the_arms_from_a_policy_server(
    client: Callable[[str], Interpreter], tmp_path: Path, rtc: bool
) -> None:
    program, planner = client("maker-station"), Planner()
    with served_robot(tmp_path / "buses", *SERVED) as served, openpi_server(planner, METADATA) as url:
        let_motors_wait(served, program)
        where = ["--station", write_station(tmp_path), "--host", "127.0.0.1", "--port", url.rpartition(":")[2]]
        flags = ["--prompt", "do it", "--seconds", str(PATIENCE_S), *["--rtc"] * rtc]
        with maker_program(program, served, tmp_path, "deploy", *where, *flags) as process:
            wait_until(tmp_path, planner.arrived.is_set)
            process.send_signal(signal.SIGINT)
            assert "connected to policy server" in wait_for_output(tmp_path, "interrupted -- estopping")
    asked = planner.asked[-1]
    assert set(asked["images"]) == set(ROLES) and asked["prompt"] == "do it"
    assert {image.shape for image in asked["images"].values()} == {(120, 160, 3)}
    assert all(image.std() > 5 for image in asked["images"].values())
    assert ("action_prefix" in asked) is rtc


@pytest.mark.parametrize("rtc", [False, True], ids=["chunks", "rtc"])
def test_deploy_when_the_policy_server_dies(client: Callable[[str], Interpreter], tmp_path: Path, rtc: bool) -> None:
    """It prints the error; the SDK's threads then hold the arms until the process is killed.

    With real-time chunking, it reports nothing: its query thread tries again and again, while the last action is held.
    """
    program, planner = client("maker-station"), Planner(requests=3)
    with served_robot(tmp_path / "buses", *SERVED) as served, openpi_server(planner, METADATA) as url:
        let_motors_wait(served, program)
        where = ["--station", write_station(tmp_path), "--host", "127.0.0.1", "--port", url.rpartition(":")[2]]
        flags = ["--prompt", "do it", "--seconds", PATIENCE_S, *["--rtc"] * rtc]
        with maker_program(program, served, tmp_path, "deploy", *where, *flags) as process:
            if rtc:
                wait_until(tmp_path, planner.died.is_set)
                time.sleep(HOLD_S)
                assert process.poll() is None
                process.send_signal(signal.SIGINT)
                assert "Traceback" not in wait_for_output(tmp_path, "interrupted -- estopping")
            else:
                assert "Traceback" in wait_for_output(tmp_path, "exceptions.ConnectionClosed")


def test_deploy_refuses_an_arm_without_a_motor(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    program, planner = client("maker-station"), Planner()
    lost = ("--fault", "lost:motor=3,channel=can_right")
    with served_robot(tmp_path / "buses", *SERVED, *lost) as served, openpi_server(planner, METADATA) as url:
        let_motors_wait(served, program, ["can_left"])
        where = ["--station", write_station(tmp_path), "--host", "127.0.0.1", "--port", url.rpartition(":")[2]]
        with maker_program(program, served, tmp_path, "deploy", *where, "--prompt", "do it"):
            said = wait_for_output(tmp_path, "failed to build arm 'right' (follower=yam_right->can_right)")
            assert "motor 3 (DM4340)" in said
    assert not planner.asked


def test_deploy_with_lost_frames_and_a_camera_that_stops(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    """Lost frames are asked for again. The policy gets the last image of the stopped camera, without a message."""
    program, planner = client("maker-station"), Swinger()
    faults = ("--fault", "drop:share=0.01,at=20", "--fault", f"silent:camera=top,at={STOP_AT_S}")
    with served_robot(tmp_path / "buses", *SERVED, *faults) as served, openpi_server(planner, METADATA) as url:
        let_motors_wait(served, program)
        where = ["--station", write_station(tmp_path), "--host", "127.0.0.1", "--port", url.rpartition(":")[2]]
        flags = ["--prompt", "do it", "--seconds", PATIENCE_S]
        with maker_program(program, served, tmp_path, "deploy", *where, *flags) as process:

            def has_stopped() -> bool:
                if "produced no frames" in (tmp_path / "output.txt").read_text(encoding="utf-8"):
                    pytest.skip("the machine is too busy: the program was not up before the camera stopped")
                return len(planner.asked) > REQUESTS and planner.images_of("top", REQUESTS) == 1

            wait_until(tmp_path, has_stopped)
            assert min(planner.images_of(role, REQUESTS) for role in ("left", "right")) > 1
            assert planner.images_of("top", len(planner.asked)) > 1
            process.send_signal(signal.SIGINT)
            said = wait_for_output(tmp_path, "interrupted -- estopping")
    assert "Traceback" not in said and "camera" not in said.lower()
    assert served.report["dropped"] > 0


@pytest.mark.parametrize("rtc", [False, True], ids=["chunks", "rtc"])
def test_the_gui_holds_the_arms_when_the_policy_server_dies(
    client: Callable[[str], Interpreter], tmp_path: Path, rtc: bool
) -> None:
    program, planner = client("maker-station"), Planner(requests=3)
    with served_robot(tmp_path / "buses", *SERVED) as served, openpi_server(planner, METADATA) as url:
        let_motors_wait(served, program)
        with maker_gui(program, served, tmp_path) as gui:
            wanted = {"port": int(url.rpartition(":")[2]), "prompt": "do it", "rtc": rtc, "save_root": "data/rollouts"}
            gui.start("deploy/start", wanted)
            if rtc:
                # It reports nothing: its query thread tries again and again, while the last action is held.
                status = gui.status_when(
                    lambda status: (
                        all(
                            np.allclose(status["arms"][side]["leader_cmd"], planner.last[k : k + 7], atol=2e-4)
                            for side, k in (("left", 0), ("right", 7))
                        )
                        and len(planner.asked) == 3
                    )
                )
                assert status["deploying"] and status["deploy_error"] is None
            else:
                status = gui.status_when(lambda status: status["deploy_error"])
                assert "ConnectionClosed" in status["deploy_error"]
                assert "arm HOLDING at last commanded pose" in status["deploy_error"]
                assert not status["deploying"] and status["live"]
            assert gui.post("/api/deploy/stop")["saved"]["frames"] > 0


def test_the_gui_refuses_an_arm_without_a_motor(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    program = client("maker-station")
    with (
        served_robot(tmp_path / "buses", *SERVED, "--fault", "lost:motor=3,channel=can_right") as served,
        maker_gui(program, served, tmp_path) as gui,
    ):
        answer = gui.post("/api/deploy/start", {"prompt": "do it"})
        assert "failed to build arm 'right' (follower=yam_right->can_right)" in answer["detail"]
        assert "motor 3 (DM4340)" in answer["detail"]
        assert not gui.ask("/api/collect/status")["live"]


def test_lost_frames_and_a_camera_that_stops(
    client: Callable[[str], Interpreter], episode: Path, tmp_path: Path
) -> None:
    """Lost frames are asked for again. The GUI records the last image of a stopped camera, and reports nothing."""
    program = client("maker-station")
    faults = ["--fault", "drop:share=0.01", "--fault", "silent:camera=top,at=60"]
    with (
        served_robot(tmp_path / "buses", *SERVED, "--leader", str(episode), *faults) as served,
        maker_gui(program, served, tmp_path) as gui,
    ):
        if "produced no frames" in str(gui.post("/api/collect/connect")):
            pytest.skip("the machine is too busy: the GUI was not up before the camera stopped")
        with CameraReader("top", served.folder) as camera, pytest.raises(TimeoutError):
            while True:
                number = camera.read(timeout=PATIENCE_S).number
                camera.read(number, timeout=20)
        gui.start("collect/start-teleop")
        gui.status_when(lambda status: status["episodes_done"] == 1)
        status = gui.ask("/api/collect/status")
        assert status["last_error"] is None and not status["estopped"]
        (listed,) = gui.ask("/api/review/episodes")["episodes"]
        cameras = gui.ask(f"/api/review/{listed['id']}/signals")["cameras"]
    assert served.report["dropped"] > 0
    changes = {role: len(set(cameras[role]["timestamps"])) for role in ROLES}
    assert changes["top"] == 1 and min(changes["left"], changes["right"]) > 1
