"""The page in a real browser, and MuJoCo's window on a virtual screen."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.jobs.view import live_rig, view_in_browser
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.compose import Contents
from yamsim_cli.core.viewers.address import PageAddress
from yamsim_cli.core.viewers.live import LiveRig
from yamsim_cli.core.viewers.viewpoint import Viewpoint

pytestmark = pytest.mark.slow

CHROMIUM, CHROMEDRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"  # the key under which WebDriver names an element
CHROMIUM_ARGS = [
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1400,900",
]


class Browser:
    """As much of a WebDriver client as these tests need."""

    def __init__(self, port: int, profile: Path) -> None:
        self._root = f"http://127.0.0.1:{port}"
        options = {"binary": str(CHROMIUM), "args": [*CHROMIUM_ARGS, f"--user-data-dir={profile}"]}
        wanted = {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": options}}
        self._root += f"/session/{self._call('POST', '/session', {'capabilities': wanted})['sessionId']}"

    def _call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._root + path, method=method, data=data)
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def open(self, url: str) -> None:
        self._call("POST", "/url", {"url": url})

    def text(self) -> str:
        text: str = self._call("POST", "/execute/sync", {"script": "return document.body.innerText", "args": []})
        return text

    def screenshot(self) -> Array:
        png = np.frombuffer(base64.b64decode(self._call("GET", "/screenshot")), np.uint8)
        return np.asarray(cv2.imdecode(png, cv2.IMREAD_COLOR))

    def press(self, selector: str, keys: str) -> None:
        element = self._call("POST", "/element", {"using": "css selector", "value": selector})[ELEMENT]
        self._call("POST", f"/element/{element}/value", {"text": keys})

    def click(self, label: str) -> None:
        path = f"//button[contains(., '{label}')]"
        element = self._call("POST", "/element", {"using": "xpath", "value": path})[ELEMENT]
        self._call("POST", f"/element/{element}/click", {})

    def close(self) -> None:
        self._call("DELETE", "")


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    if not (CHROMIUM.exists() and CHROMEDRIVER.exists()):
        pytest.skip("chromium and chromium-driver are not here: tools/ensure_test_programs.sh")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    driver = subprocess.Popen([CHROMEDRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: answers(port))
        client = Browser(port, tmp_path / "profile")
        yield client
        client.close()
    finally:
        driver.terminate()
        driver.wait(10)


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def wait_until(true: Callable[[], object], seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.1)


@contextmanager
def served(live: LiveRig) -> Iterator[str]:
    """The URL of a page on which the rig runs."""
    urls: list[str] = []
    ended = threading.Event()
    thread = threading.Thread(target=view_in_browser, args=(live, PageAddress(), urls.append, ended.is_set))
    thread.start()
    try:
        wait_until(lambda: urls)
        yield urls[0]
    finally:
        ended.set()
        thread.join()


@pytest.fixture
def live(locations: Locations) -> LiveRig:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    rig = load_config(RigConfig, "rigs", "russet", locations)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    return live_rig(rig, scene, Contents(), locations, {"i2rt_yam_crank": None})


def test_a_slider_and_the_buttons_move_the_arm(live: LiveRig, browser: Browser) -> None:
    with served(live) as url:
        browser.open(url)
        wait_until(lambda: "real time" in browser.text())
        page = browser.text()
        assert "arm1" in page
        assert "arm2" in page
        assert len(np.unique(browser.screenshot().reshape(-1, 3), axis=0)) > 500, "the picture is blank"

        joint = live.data.joint("joint1")
        browser.press("[role=slider]", "\ue014" * 200)  # arrow right, 1 mrad each
        wait_until(lambda: live.data.ctrl[0] > 0.15)
        wait_until(lambda: joint.qpos[0] > 0.1)
        browser.click("Home")
        wait_until(lambda: live.data.ctrl[0] == 0 and abs(joint.qpos[0]) < 0.01)
        browser.click("Pause")
        wait_until(lambda: live.paused and "paused" in browser.text())


def test_the_boards_on_the_page_are_the_rigs_own(
    live: LiveRig, browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seen from straight above, every marker is read, and in its place: not mirrored, not turned."""
    rig = live.rig
    places = {}
    for k, arm in enumerate(rig.arms):
        assert arm.board is not None
        T_board_in_world = rig.T_base_in_world(k) @ arm.board.T_board_in_arm
        for number, corners in zip(arm.board.board.ids, arm.board.board.corners(), strict=True):
            places[number] = (T_board_in_world @ (*corners.mean(axis=0), 1.0))[:2]
    middle = np.array([*np.mean(list(places.values()), axis=0), 0.0])
    # The picture's right is then world +x, its top world +y. A hair off the vertical, where "up" has no meaning.
    above = Viewpoint(middle, distance=0.75, azimuth_deg=90, elevation_deg=-89.5)
    monkeypatch.setattr("yamsim_cli.core.jobs.view.frame_rig", lambda _: above)
    # Out of the way: arms up and back.
    for k in range(2):
        live.data.ctrl[7 * k : 7 * k + 3] = (0, 0, 0)
    with served(live) as url:
        browser.open(url)
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
        seen: dict[int, Array] = {}

        def look() -> bool:
            corners, ids, _ = detector.detectMarkers(browser.screenshot())
            # OpenCV 4 gives ids as a column and None for none, OpenCV 5 as a row.
            numbers = [] if ids is None else np.ravel(ids).tolist()
            seen.update(
                {number: np.reshape(four, (4, 2)).mean(axis=0) for number, four in zip(numbers, corners, strict=True)}
            )
            return len(seen) == len(places)

        wait_until(look)
    pixels = np.array([seen[number] for number in sorted(places)])
    world = np.array([places[number] for number in sorted(places)]) - middle[:2]
    # One scale and one offset explain all marker centres: (u, v) = centre + s (x, -y).
    flipped = world * (1, -1)
    scale = np.sum((pixels - pixels.mean(axis=0)) * flipped) / np.sum(flipped**2)
    assert scale > 0
    assert np.abs(pixels - pixels.mean(axis=0) - scale * flipped).max() < 2.0


@pytest.fixture
def screen() -> Iterator[str]:
    """A virtual screen's name."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not here: tools/ensure_test_programs.sh")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    try:
        os.close(write)
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)


def test_the_window_opens_on_a_display_and_a_signal_ends_it(screen: str, repository: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", "view", "--rig", "russet", "--json"],
        cwd=repository,
        env={**os.environ, "DISPLAY": screen, "LIBGL_ALWAYS_SOFTWARE": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        said = ""
        while not re.search(r"\}\s*$", said):
            line = process.stdout.readline()
            assert line, process.stderr and process.stderr.read()
            said += line
        assert json.loads(said) == {"url": None}
        time.sleep(2)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        remarks = [line for line in err.splitlines() if not line.startswith("The meshes of")]
        assert (process.returncode, remarks) == (0, [])
    finally:
        process.kill()
        process.communicate()
