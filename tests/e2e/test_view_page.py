"""The page in a real browser, and MuJoCo's window on a virtual screen."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.cli.serve_cli import shown
from tests.e2e.browser import Browser, wait_until
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.viewers.page_address import PageAddress
from yamsim_cli.viewers.show.viewer import make_live_rig, view_rig
from yamsim_cli.viewers.viewed_scene import LiveRig
from yamsim_cli.viewers.viewpoint import Viewpoint

pytestmark = pytest.mark.slow


@contextmanager
def served(live: LiveRig, *, pictures: bool = False) -> Iterator[str]:
    """The URL of a page with the running rig."""
    urls: list[str] = []
    ended = threading.Event()
    thread = threading.Thread(
        target=view_rig,
        args=(live, PageAddress(), urls.append, ended.is_set),
        kwargs={"pictures": pictures},
    )
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
    return make_live_rig(Blueprint(rig, scene), locations)


@pytest.mark.long
def test_a_slider_and_the_buttons_move_the_arm(live: LiveRig, browser: Browser, screens: Path) -> None:
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
        browser.screenshot(screens / "view_slider.png")
        browser.click("Home")
        wait_until(lambda: live.data.ctrl[0] == 0 and abs(joint.qpos[0]) < 0.01)
        browser.click("Pause")
        wait_until(lambda: live.paused and "paused" in browser.text())


@pytest.mark.long
def test_the_boards_on_the_page_are_the_rigs_own(
    live: LiveRig, browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From straight above, every marker is read at its place: neither mirrored nor rotated."""
    rig = live.rig
    places = {}
    for k, arm in enumerate(rig.arms):
        assert arm.board is not None
        T_board_in_world = rig.T_base_in_world(k) @ arm.T_board_in_base
        for number, corners in zip(
            arm.board.board_in_metres.marker_ids, arm.board.board_in_metres.marker_corners(), strict=True
        ):
            places[number] = (T_board_in_world @ (*corners.mean(axis=0), 1.0))[:2]
    middle = np.array([*np.mean(list(places.values()), axis=0), 0.0])
    # The picture's right is world +x, its top world +y. Slightly off the vertical, where "up" is undefined.
    above = Viewpoint(middle, distance=0.75, azimuth_deg=90, elevation_deg=-89.5)
    monkeypatch.setattr("yamsim_cli.viewers.show.viewer.rig_viewpoint", lambda _: above)
    # Arms up and back, out of view.
    for k in range(2):
        live.data.ctrl[7 * k : 7 * k + 3] = (0, 0, 0)
    with served(live) as url:
        browser.resize(1400, 900)
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


@pytest.mark.render
def test_margin_and_cameras_on_the_page(live: LiveRig, browser: Browser, screens: Path) -> None:
    with served(live, pictures=True) as url:
        browser.open(url)
        wait_until(lambda: "real time" in browser.text())
        browser.click("Take pictures")
        wait_until(lambda: browser.run("return document.querySelectorAll('img[src^=\"blob:\"]').length") == 2)
        # The slider of the margin follows seven sliders of each arm.
        script = "document.querySelectorAll('[role=slider]')[14].focus()"
        browser.run(script)
        browser.keys("\ue014" * 100)
        wait_until(lambda: live.rig.margin > 0.65)
        base = live.model.body("arm2_base_board").id
        assert live.body_poses()[0][base][1] == pytest.approx(live.rig.margin / 2)
        browser.screenshot(screens / "view_cameras.png")
        browser.click("Look through right_wrist_camera")
        time.sleep(1)
        browser.screenshot(screens / "view_through_wrist.png")


@pytest.mark.long
@pytest.mark.render
def test_a_task_and_its_episode_in_the_browser(browser: Browser, tmp_path: Path, screens: Path) -> None:
    out = tmp_path / "d"
    done = yamsim("record", "--n", "1", "--workers", "1", "--out", str(out), "--wrist", "--size", "160x120")
    assert done.code == 0, done.err
    for name, args in (("task", ("--task", "pickplace")), ("episode", ("--episode", str(out / "ep_000000")))):
        with shown("view", "--web", "--port", "0", *args) as page:
            browser.open(page.url)
            wait_until(lambda: " s" in browser.text() and "Pause" in browser.text())
            if name == "episode":
                wait_until(lambda: browser.run("return document.querySelectorAll('img[src^=\"blob:\"]').length") == 2)
                assert "scene_camera" in browser.text()
                assert "right_wrist_camera" in browser.text()
            time.sleep(2)
            browser.screenshot(screens / f"view_{name}.png")
            assert page.end() == (0, "", [])


def test_the_window_opens_on_a_display_and_a_signal_ends_it(screen: str) -> None:
    with shown("view", "--rig", "russet", DISPLAY=screen, LIBGL_ALWAYS_SOFTWARE="1") as window:
        assert window.report == {"url": None}
        time.sleep(2)
        assert window.still_runs()
        assert window.end() == (0, "", [])
