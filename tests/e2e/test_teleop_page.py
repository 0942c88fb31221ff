"""The teleoperation page in a real browser: a user's actions end as an episode."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.e2e.browser import Browser, wait_until
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.viewers.page_address import PageAddress
from yamsim_cli.viewers.show.viewer import task_viewpoint
from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene
from yamsim_cli.viewers.teleop.teleop_session import open_teleop, run_page
from yamsim_cli.viewers.teleop_page import hand_heading
from yamsim_cli.viewers.viewpoint import FOV_DEG

REPOSITORY = Path(__file__).parents[2]

pytestmark = [pytest.mark.slow, pytest.mark.render]

# Set an input as React expects it from a person's typing.
SET_NUMBER = """
const fields = [...document.querySelectorAll('input')].filter(input => input.type === 'text').slice(-4);
const input = fields[arguments[0]];
Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(input, arguments[1]);
input.dispatchEvent(new Event('input', {bubbles: true}));
// In a field, letters are no keys.
document.activeElement.blur();
"""
NUMBERS = "return [...document.querySelectorAll('input')].filter(i => i.type === 'text').slice(-4).map(i => i.value)"
X, Y, Z, HEADING = range(4)


def pixel(config: RecordConfig, browser: Browser, point: Array) -> tuple[float, float]:
    """Return the pixel of a point of `world` in the page's picture."""
    view = task_viewpoint(config)
    forward = (view.look_at - view.position) / view.distance
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    ray = point - view.position
    width, height = browser.run("return [innerWidth, innerHeight]")
    scale = height / 2 / math.tan(math.radians(FOV_DEG / 2)) / (ray @ forward)
    return width / 2 + scale * (ray @ right), height / 2 - scale * (ray @ np.cross(right, forward))


@contextmanager
def driving(config: RecordConfig, locations: Locations, out: Path) -> Iterator[tuple[str, TeleopScene]]:
    """A teleoperation page: its URL, and its session. Prints the jitter."""
    urls: list[str] = []
    scenes: list[TeleopScene] = []
    stop = StopRequest()

    def serve() -> None:
        with open_teleop(Session(config, locations), out, ExistingDatasetMode.NEW, print) as session:
            scenes.append(session.scene)
            print(run_page(session, config, PageAddress(), urls.append, stop).jitter)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        wait_until(lambda: urls)
        yield urls[0], scenes[0]
    finally:
        stop.request_stop()
        thread.join()


def at(driven: TeleopScene, place: Array, tolerance: float = 0.006) -> bool:
    """Whether the hand is at a place, at rest."""
    near = np.linalg.norm(driven.data.site("pinch_site").xpos - place) < tolerance
    return bool(near and np.abs(driven.data.qvel[:6]).max() < 0.02)


@pytest.mark.long
def test_a_drag_of_the_gizmo_moves_the_hand(
    config: RecordConfig, locations: Locations, browser: Browser, tmp_path: Path, screens: Path
) -> None:
    with driving(config, locations, tmp_path / "d") as (url, driven):
        browser.open(url)
        wait_until(lambda: "not recording" in browser.text())
        time.sleep(2)
        before = driven.target_pose
        # The arrow along the hand's y axis, which is the world's here.
        arrow = before[:3, 3] + 0.11 * before[:3, 1]
        start, end = (pixel(config, browser, point) for point in (arrow, arrow + 0.1 * before[:3, 1]))
        browser.drag(start, end)
        browser.screenshot(screens / "teleop_dragged.png")
        wait_until(lambda: driven.target_pose[1, 3] > 0.05)
        moved = driven.target_pose[:3, 3] - before[:3, 3]
        assert np.allclose(moved, (0, moved[1], 0), atol=2e-3)
        assert moved[1] == pytest.approx(0.1, abs=0.04)
        wait_until(lambda: at(driven, driven.target_pose[:3, 3], 0.01))


@pytest.mark.long
def test_every_key_counts_and_none_overtakes_a_number(
    config: RecordConfig, locations: Locations, browser: Browser, tmp_path: Path
) -> None:
    with driving(config, locations, tmp_path / "d") as (url, driven):
        browser.open(url)
        wait_until(lambda: "not recording" in browser.text())
        x, _, z = driven.target_pose[:3, 3]
        browser.run(SET_NUMBER, Y, "0.080")
        browser.keys("iiyyyhk")
        wanted = (x + 0.01, 0.08, z + 0.02)
        wait_until(lambda: np.allclose(driven.target_pose[:3, 3], wanted, atol=1e-6))
        # All numbers are sent at once: before the page has followed, the other numbers would be old.
        wait_until(lambda: np.allclose([float(n) for n in browser.run(NUMBERS)[:3]], wanted, atol=6e-4))
        browser.run(SET_NUMBER, X, "0.300")
        wait_until(lambda: at(driven, np.array((0.3, *wanted[1:]))))
        assert np.allclose([float(n) for n in browser.run(NUMBERS)[:3]], (0.3, *wanted[1:]), atol=6e-4)


def test_what_is_done_on_the_page_is_an_episode(
    make_config: Callable[..., RecordConfig], locations: Locations, browser: Browser, tmp_path: Path, screens: Path
) -> None:
    config = make_config({("image", "size_px"): [160, 120], ("render",): "fast"})
    out = tmp_path / "d"
    with Simulator(Session(config, locations).without_meshes()) as simulator:
        layout = sample_attempt(simulator, AttemptJob(config.seed, 0)).layout
    assert layout
    banana = next(item for item in config.task.objects if item.name == "banana")
    assert banana.grasp
    T_grasp = layout.T_in_world["banana"] @ banana.grasp.T_pinch_in_object(False)
    T_goal = layout.T_in_world["plate"]
    with driving(config, locations, out) as (url, driven):

        def go(place: tuple[float, float, float]) -> None:
            for field in (X, Y, Z):
                browser.run(SET_NUMBER, field, f"{place[field]:.3f}")
            wait_until(lambda: at(driven, np.array(place)))

        browser.open(url)
        wait_until(lambda: "not recording" in browser.text())
        browser.click("Start recording")
        wait_until(lambda: driven.is_recording and "not recording" not in browser.text())
        home = browser.run(NUMBERS)
        browser.click("Point down")
        wait_until(lambda: driven.target_pose[2, 2] < -0.999)
        heading = math.degrees(math.atan2(T_grasp[1, 1], T_grasp[0, 1]))
        # A gripper turned by 180 degrees is equivalent.
        heading = heading if heading > 0 else heading + 180
        browser.run(SET_NUMBER, HEADING, f"{heading:.1f}")
        wait_until(lambda: hand_heading(driven.target_pose) == pytest.approx(math.radians(heading), abs=0.001))
        x, y, z = T_grasp[:3, 3]
        go((x, y, 0.15))
        go((x, y, z))
        browser.keys("g")
        wait_until(lambda: "Open gripper" in browser.text())
        time.sleep(1)
        browser.keys("m")
        wait_until(lambda: "holds the object" in browser.text())
        browser.screenshot(screens / "teleop_grasped.png")
        go((x, y, 0.2))
        x, y, _ = T_goal[:3, 3]
        go((x, y, 0.2))
        go((x, y, 0.06))
        browser.screenshot(screens / "teleop_placing.png")
        browser.keys("gm")
        wait_until(lambda: not driven.status.is_weld_holding)
        time.sleep(1)
        go((x, y, 0.2))
        browser.click("Stop and judge")
        wait_until(lambda: "1 episode, 0 failed" in browser.text())
        assert "attempt 0: ep_000000" in browser.text()

        # A second, discarded recording, and a target out of reach.
        browser.keys("r")
        wait_until(lambda: driven.is_recording)
        wait_until(lambda: browser.run(NUMBERS) == home)
        browser.run(SET_NUMBER, X, "1.200")
        wait_until(lambda: "out of reach" in browser.text())
        browser.screenshot(screens / "teleop_out_of_reach.png")
        browser.keys("x")
        wait_until(lambda: not driven.is_recording and "discarded" in browser.text())
    record = json.loads((out / "ep_000000" / "episode.json").read_text())
    assert (record["source"], record["outcome"]["success"]) == ("teleop", True)
    summary = yamsim("summarize", str(out), "--strict", "--json")
    assert summary.code == 0, summary.out
    verified = yamsim("verify", str(out), "--json")
    assert (verified.code, json.loads(verified.out)["max_error"]) == (0, 0)


@pytest.mark.long
def test_a_page_that_is_closed_pauses_its_recording(
    config: RecordConfig, locations: Locations, browser: Browser, tmp_path: Path
) -> None:
    with driving(config, locations, tmp_path / "d") as (url, driven):
        browser.open(url)
        wait_until(lambda: "not recording" in browser.text())
        browser.click("Start recording")
        wait_until(lambda: driven.is_recording)
        browser.open("about:blank")
        wait_until(lambda: driven.paused)
        before = driven.status.seconds
        time.sleep(1)
        assert driven.status.seconds == before
        browser.open(url)
        wait_until(lambda: "no browser was connected" in browser.text())
        browser.click("Play")
        wait_until(lambda: driven.status.seconds > before)


@pytest.mark.long
def test_a_page_whose_server_is_killed_says_so(browser: Browser, tmp_path: Path, screens: Path) -> None:
    command = ["teleop", "--out", str(tmp_path / "d"), "--port", "0", "--quality", "fast", "--size", "64x48"]
    process = subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", *command],
        cwd=REPOSITORY,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        url = ""
        while not url:
            found = re.search(r"http://127\.0\.0\.1:\d+", process.stderr.readline())
            url = found[0] if found else ""
        browser.open(url)
        wait_until(lambda: "not recording" in browser.text())
        browser.click("Start recording")
        wait_until(lambda: re.search(r"recording \d", browser.text()))
        assert "Disconnected" not in browser.text()
    finally:
        process.kill()
        process.communicate()
    wait_until(lambda: "Disconnected" in browser.text())
    browser.screenshot(screens / "teleop_killed.png")
    assert list((tmp_path / "d" / ".recordings").glob("*.jsonl"))
