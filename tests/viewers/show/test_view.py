"""A live rig, its page, and `yamsim view` as a user runs it: started, watched, ended by a signal."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.cli.serve_cli import shown
from tests.programs import FOLD, ONTO_PLATE, first_attempt, session_of
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import quat_from_rotation
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.viewers.page_address import PageAddress
from yamsim_cli.viewers.show.viewer import FRAME_PERIOD, LivePictures, make_live_rig, make_live_task
from yamsim_cli.viewers.viewed_scene import EpisodePlayer, LiveRig
from yamsim_cli.viewers.viewpoint import FOV_DEG, rig_viewpoint

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture
def live(locations: Locations) -> LiveRig:
    rig = load_config(RigConfig, "rigs", "russet", locations)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    return make_live_rig(Blueprint(rig, scene), locations)


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def open_page() -> Iterator[Callable[..., Any]]:
    """Opens pages of live rigs, which are closed after the test."""
    module = pytest.importorskip("yamsim_cli.viewers.rig_page", reason="yamsim[view] is not installed")
    with contextlib.ExitStack() as stack:

        def opened(live: LiveRig, port: int = 0, **options: Any) -> Any:
            page = module.RigPage(live, rig_viewpoint(live.rig), PageAddress(port), **options)
            stack.callback(page.close)
            return page

        yield opened


def message(err: str) -> str:
    """The line on stderr, without the note on missing meshes."""
    (line,) = [line for line in err.splitlines() if not line.startswith("The meshes of")]
    return line


def run(live: LiveRig, seconds: float, began: float = 0.0) -> None:
    """Advance by pictures, on a clock of the test."""
    for k in range(round(seconds / FRAME_PERIOD) + 1):
        live.advance_to(began + k * FRAME_PERIOD)


def listeners(port: int) -> list[str]:
    """Local addresses, as the kernel writes them in hex, that listen on a port."""
    found = []
    for table in (Path("/proc/net/tcp"), Path("/proc/net/tcp6")):
        for line in table.read_text().splitlines()[1:] if table.exists() else []:
            _, local, _, state, *_ = line.split()
            address, _, number = local.partition(":")
            if state == "0A" and int(number, 16) == port:
                found.append(address)
    return found


def test_physics_keeps_up_with_the_clock(live: LiveRig) -> None:
    run(live, 2.0)
    assert live.simulated_seconds == pytest.approx(2.0, abs=0.003)


def test_a_stall_is_not_made_up_for(live: LiveRig) -> None:
    live.advance_to(0.0)
    live.advance_to(3600.0)
    assert live.simulated_seconds == pytest.approx(0.1, abs=0.003)


def test_a_paused_rig_stands_still_and_goes_on_where_it_was(live: LiveRig) -> None:
    live.paused = True
    run(live, 1.0)
    assert live.simulated_seconds == 0
    live.paused = False
    live.advance_to(1.0 + FRAME_PERIOD)
    assert live.simulated_seconds == pytest.approx(FRAME_PERIOD, abs=0.003)


def test_a_drive_moves_its_joint_and_no_other_arm(live: LiveRig) -> None:
    drive = next(drive for drive in live.drives if (drive.arm, drive.name) == ("arm2", "joint1"))
    live.set_command(drive, 0.5)
    run(live, 3.0)
    assert live.data.joint("arm2_joint1").qpos[0] == pytest.approx(0.5, abs=0.05)
    assert live.data.joint("joint1").qpos[0] == pytest.approx(0.0, abs=0.01)
    live.set_command(drive, 99.0)
    assert live.data.ctrl[drive.actuator] == drive.high, "a command stays in its range"
    live.reset()
    assert np.array_equal(live.data.qpos, live.model.key_qpos[0])
    assert np.array_equal(live.data.ctrl, live.model.key_ctrl[0])


@pytest.mark.parametrize("name", ["single", "bimanual", "russet"])
def test_the_first_view_holds_every_arm_and_board(name: str, locations: Locations) -> None:
    rig = load_config(RigConfig, "rigs", name, locations)
    view = rig_viewpoint(rig)
    sight = (view.look_at - view.position) / view.distance
    for k, arm in enumerate(rig.arms):
        base = rig.T_base_in_world(k)
        assert arm.board is not None
        board = (base @ arm.T_board_in_base)[:3, 3]
        for point in (base[:3, 3], board, base[:3, 3] + (0.3, 0.0, 0.3)):
            ray = (point - view.position) / np.linalg.norm(point - view.position)
            assert np.degrees(np.arccos(ray @ sight)) < FOV_DEG / 2


def test_page_answers_on_loopback_alone_and_its_sliders_reach_the_joints(
    live: LiveRig, free_port: int, open_page: Callable[..., Any]
) -> None:
    page = open_page(live, free_port)
    assert page.url == f"http://127.0.0.1:{free_port}"
    with urllib.request.urlopen(page.url, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()
    if Path("/proc/net/tcp").exists():
        assert listeners(free_port) == ["0100007F"]
    assert set(page.sliders) == {(drive.arm, drive.name) for drive in live.drives}
    page.sliders["arm1", "joint1"].value = 0.4
    run(live, 3.0)
    page.update()
    assert live.data.joint("joint1").qpos[0] == pytest.approx(0.4, abs=0.05)
    with pytest.raises(ResourceError, match=rf"--port {free_port} cannot be used .*: give another, or 0"):
        open_page(live, free_port)
    page.close()
    assert listeners(free_port) == []


@pytest.mark.parametrize("margin", [None, 0.9])
def test_boards_and_mounts_stand_with_their_arms(live: LiveRig, margin: float | None) -> None:
    if margin is not None:
        live.set_margin(margin)
    for action in (lambda: run(live, 0.5), live.reset):
        action()
        positions, quaternions = live.body_poses()
        for k, arm in enumerate(live.rig.arms):
            T = live.rig.T_base_in_world(k)
            assert margin is None or abs(T[1, 3]) == pytest.approx(margin / 2)
            for name in ("arm", "base_board", "base_mount"):
                body = live.model.body(arm.prefix + name).id
                assert np.allclose(positions[body], T[:3, 3], atol=1e-6), name
                assert np.allclose(quaternions[body], quat_from_rotation(T[:3, :3]), atol=1e-6), name


def test_a_task_stands_as_its_seed_says(config: RecordConfig, locations: Locations) -> None:
    live = make_live_task(Session(config, locations))
    with Simulator(Session(config, locations)) as simulator:
        layout = sample_attempt(simulator, AttemptJob(config.seed, 0)).layout
    assert layout
    positions, _ = live.body_poses()
    assert set(layout.T_in_world) == {"banana", "plate"}
    for name, T in layout.T_in_world.items():
        assert np.allclose(positions[live.model.body(name).id], T[:3, 3], atol=1e-3)
    assert [live.model.cam(k).name for k in range(live.model.ncam)] == ["scene_camera", "right_wrist_camera"]


def test_a_task_that_is_data_stands_as_its_first_attempt(tmp_path: Path) -> None:
    opened = {
        "things": {"cabinet": {"of": "drawer_cabinet"}, "cube": {"of": ["cube_red", "cube_blue"]}},
        "starts": {
            "cabinet": {"x": [0.52, 0.54], "y": [-0.03, 0.03], "yaw_deg": [-5, 5], "open": {"drawer": [0.5, 0.6]}},
            "cube": {"x": [0.22, 0.30], "y": [-0.2, 0.2], "apart": 0.04},
        },
        "goal": {"all": [{"in": {"thing": "cube", "container": "cabinet"}}]},
        "expert": [{"pick": {"thing": "cube"}}, {"place": {"thing": "cube", "on": "cabinet"}}],
    }
    session = session_of(tmp_path, ONTO_PLATE | opened)
    live = make_live_task(session)
    with SimulatorCache(session) as simulators:
        simulator, attempt = first_attempt(simulators)
    assert attempt.layout is not None and simulator.roles is not None
    positions, quaternions = live.body_poses()
    for name, T in attempt.layout.T_in_world.items():
        body = live.model.body(name).id
        assert np.allclose(positions[body], T[:3, 3], atol=1e-6)
        assert np.allclose(np.abs(quaternions[body] @ quat_from_rotation(T[:3, :3])), 1, atol=1e-6)
    low, high = live.model.joint("cabinet_drawer").range
    assert 0.45 < (live.data.joint("cabinet_drawer").qpos[0] - low) / (high - low) < 0.65
    live.reset()
    run(live, 1.0)
    after, _ = live.body_poses()
    assert np.abs(after[live.model.body("cube").id] - positions[live.model.body("cube").id]).max() < 2e-3


def test_cloth_is_shown_where_its_points_are(tmp_path: Path, open_page: Callable[..., Any]) -> None:
    live = make_live_task(session_of(tmp_path, FOLD))
    page = open_page(live)
    (node,) = page.cloths.nodes
    assert node.vertices.shape == (81, 3) and node.faces.shape == (128, 3)
    live.data.qpos[:] += 0.1
    mujoco.mj_forward(live.model, live.data)
    page.update()
    assert np.abs(node.vertices - live.data.flexvert_xpos).max() < 2e-5
    # A triangle's sides are those of the grid, not lines across the sheet.
    sides = np.linalg.norm(node.vertices[node.faces[:, 0]] - node.vertices[node.faces[:, 1]], axis=1)
    assert 0.02 < sides.min() <= sides.max() < 0.04
    # Half of its checks are nearly white, half are red.
    assert np.abs(np.array(node.color) - (201, 138, 128)).max() <= 2


def test_a_player_shows_cloth_as_each_frame_has_it(tmp_path: Path) -> None:
    live = make_live_task(session_of(tmp_path, FOLD))
    lying = live.cloth_points()
    player = EpisodePlayer("test", live.model, np.array([live.data.qpos, live.data.qpos + 0.1]), 0.064)
    assert np.abs(player.cloth_points() - lying).max() < 1e-9
    player.seek(1)
    # All of it moves equally, along the axes of the cloth, which starts rotated.
    moved = player.cloth_points() - lying
    assert np.ptp(moved, axis=0).max() < 1e-9
    assert np.linalg.norm(moved[0]) == pytest.approx(0.1 * 3**0.5)


def test_the_page_shows_what_its_switches_say(live: LiveRig, open_page: Callable[..., Any]) -> None:
    page = open_page(live, boards=False)
    assert not page.bodies.frames[live.model.body("arm2_base_board").id].visible
    assert all(node.visible for node in page.bodies.visuals)
    page.margin.value = 0.8
    assert live.rig.margin == 0.8


@pytest.mark.render
def test_pictures_are_what_the_cameras_see_now(live: LiveRig, open_page: Callable[..., Any]) -> None:
    pictures = LivePictures(live)
    page = open_page(live, pictures=pictures)
    try:
        panel = page.cameras
        page.update()
        assert not panel.images, "nothing is drawn before it is requested"
        panel.request()
        page.update()
        assert set(panel.images) == {"right_wrist_camera", "left_wrist_camera"}
        before = panel.images["right_wrist_camera"].image
        assert before.shape == (240, 320, 3)
        assert before.std() > 5
        live.set_command(live.drives[0], 1.0)
        run(live, 2.0)
        panel.request()
        page.update()
        assert np.abs(panel.images["right_wrist_camera"].image.astype(int) - before).mean() > 1
    finally:
        pictures.close()


@pytest.mark.parametrize(("args", "warned"), [((), False), (("--host", "0.0.0.0"), True)])
def test_a_page_that_others_can_reach_warns_that_it_is_open(args: tuple[str, ...], warned: bool) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    with shown("view", "--web", "--port", "0", *args) as page:
        port = int(page.url.rpartition(":")[2])
        assert page.url == f"http://127.0.0.1:{port}"
        if Path("/proc/net/tcp").exists():
            assert listeners(port) == ["00000000" if warned else "0100007F"]
        code, _, notes = page.end(signal.SIGTERM)
    assert any("asks for no password" in line for line in notes) == warned
    assert code == 0


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_page_cleanly_and_its_port_is_free_again(number: signal.Signals) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    with shown("view", "--web", "--port", "0") as page:
        port = page.url.rpartition(":")[2]
        # A connected peer, and one that never sends anything, both impede a clean end.
        with urllib.request.urlopen(page.url, timeout=10), socket.create_connection(("127.0.0.1", int(port))):
            ended = page.end(number)
        assert ended == (0, "", [])
    assert listeners(int(port)) == []
    with shown("view", "--web", "--port", port) as again:
        assert again.url == page.url


NO_DISPLAY = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}


@pytest.mark.parametrize(
    ("args", "env", "code", "words"),
    [
        (("--native",), NO_DISPLAY, 4, "use --web"),
        (("--native",), {"DISPLAY": ":987", "WAYLAND_DISPLAY": ""}, 4, "use --web"),
        (("--native", "--port", "8000"), {}, 2, "--port 8000"),
        (("--native", "--host", "0.0.0.0"), {}, 2, "--host 0.0.0.0 is for the browser page"),
        (("--episode", "dataset/ep_000000", "--rig", "russet"), {}, 2, "--rig is not for --episode"),
        (("--seed", "3"), {}, 2, "give --task"),
        (("--web", "--rig", "russet", "--margin", "-1"), {}, 2, "--margin: "),
    ],
)
def test_faults_are_one_line(args: tuple[str, ...], env: dict[str, str], code: int, words: str) -> None:
    found = yamsim("view", *args, env=env)
    assert (found.code, words in message(found.err)) == (code, True), found.err


def test_a_taken_port_says_what_to_do(free_port: int) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port))
        taken.listen()
        busy = yamsim("view", "--web", "--port", str(free_port))
    assert (busy.code, f"--port {free_port} cannot be used" in message(busy.err)) == (4, True)


def test_a_missing_library_is_named_with_its_extra(tmp_path: Path) -> None:
    (tmp_path / "viser.py").write_text("raise ModuleNotFoundError(\"No module named 'viser'\", name='viser')")
    missing = yamsim("view", "--web", env={"PYTHONPATH": os.pathsep.join([str(tmp_path), str(REPOSITORY)])})
    assert (missing.code, "`pip install 'yamsim[view]'`" in message(missing.err)) == (4, True)
