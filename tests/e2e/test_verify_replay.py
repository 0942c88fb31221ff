"""Recorded, verified and filmed as a user does it, and watched in a real browser and in MuJoCo's window."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.attempts import planned
from tests.cli.run_cli import yamsim
from tests.cli.serve_cli import shown
from tests.e2e.browser import Browser, wait_until
from tests.e2e.test_record_summarize import digest, frames
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations

pytestmark = [pytest.mark.render, pytest.mark.slow]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("verify") / "one"
    run = yamsim("record", "--n", "2", "--workers", "1", "--size", "96x72", "--seed", "6", "--out", path)
    assert run.code == 0, run.err
    return path


def test_datasets_by_one_worker_and_by_three_are_the_same_and_both_verify(dataset: Path, tmp_path: Path) -> None:
    three = tmp_path / "three"
    run = yamsim("record", "--n", "2", "--workers", "3", "--size", "96x72", "--seed", "6", "--out", three)
    assert run.code == 0, run.err
    assert digest(three) == digest(dataset)
    for path, workers in ((dataset, "3"), (three, "1")):
        report = yamsim("verify", path, "--workers", workers, "--images", "--json").json
        assert (report["agree"], report["max_error"], report["versions_changed"]) == (2, 0.0, [])
        assert report["checks"]["images"] | {"largest": None} == {
            "episodes": 2,
            "agree": 2,
            "max_error": 0.0,
            "largest": None,
            "skipped": [],
        }


def test_an_image_that_shows_something_else_is_named(dataset: Path) -> None:
    file = dataset / "ep_000001" / "rgb" / "scene_camera" / "000030.jpg"
    whole = file.read_bytes()
    image = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_COLOR)
    image[:36, :48] = 0
    try:
        file.write_bytes(cv2.imencode(".jpg", image)[1].tobytes())
        run = yamsim("verify", dataset, "--episodes", "1", "--images", "--json")
        assert run.code == 4
        first = run.json["first_divergence"]
        assert (first["check"], first["frame"], first["quantity"]) == ("images", 30, "rgb/scene_camera/000030.jpg")
        assert 1 < first["difference"] < 255
        # Without images, nothing else is wrong.
        assert yamsim("verify", dataset, "--episodes", "1").code == 0
        assert yamsim("verify", dataset, "--episodes", "1", "--images", "--image-tolerance", "255").code == 0
    finally:
        file.write_bytes(whole)


def test_an_episode_drawn_anew_shows_what_was_recorded(dataset: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="yamsim[video] is not installed")
    films = []
    for name, extra in (("recorded", ()), ("drawn", ("--render",))):
        run = yamsim("replay", dataset / "ep_000000", "--video", tmp_path / f"{name}.mp4", *extra, "--json")
        assert (run.code, run.json["rendered"]) == (0, bool(extra)), run.err
        with av.open(str(tmp_path / f"{name}.mp4")) as container:
            films.append(np.array([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], float))
    assert films[0].shape == films[1].shape == (frames(dataset)[0], 72, 96, 3)
    assert np.abs(films[0] - films[1]).mean() < 4
    assert np.abs(films[0][0] - films[0][40]).mean() > 2, "nothing moves"
    wrist = ("--render", "--camera", "right_wrist_camera", "--size", "64x48")
    run = yamsim("replay", dataset / "ep_000000", "--video", tmp_path / "wrist.mp4", *wrist, "--json")
    assert (run.json["size"], run.json["cameras"]) == ([64, 48], ["right_wrist_camera"])


def test_trials_are_filmed_failures_first(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    av = pytest.importorskip("av", reason="yamsim[video] is not installed")
    config = tmp_path / "small.yaml"
    text = (Path(__file__).parents[2] / "configs" / "record" / "default.yaml").read_text()
    config.write_text(re.sub(r"size_px: \[.*\]", "size_px: [64, 48]", text))
    batch = ("pickplace", "batch", "--config", config, "--n", "6", "--seed", "2", "--threshold", "0.0035")
    run = yamsim(*batch, "--video", tmp_path / "films", "--video-trials", "2", "--json")
    assert run.code == 0, run.err
    failed = [trial["trial"] for trial in run.json["trials"] if not trial["outcome"]["success"]]
    assert len(failed) == 1
    names = [f"trial_{failed[0]:06d}_off_target.mp4", "trial_000000_success.mp4"]
    assert [Path(film["path"]).name for film in run.json["videos"]] == names
    assert sorted(path.name for path in (tmp_path / "films").iterdir()) == sorted(names)
    with Simulator(
        Session(make_config({("task", "goal", "on", "radius"): 0.0035}), locations).without_meshes()
    ) as simulator:
        lengths = [len(planned(simulator, 2, number).recorded_states) for number in (failed[0], 0)]
    for name, length in zip(names, lengths, strict=True):
        with av.open(str(tmp_path / "films" / name)) as container:
            assert sum(1 for _ in container.decode(video=0)) == length
    again = yamsim(*batch, "--video", tmp_path / "films")
    assert (again.code, "--overwrite" in again.message) == (2, True)
    run = yamsim(*batch, "--video", tmp_path / "reel.mp4", "--video-trials", "2")
    assert run.code == 0, run.err
    with av.open(str(tmp_path / "reel.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == sum(lengths)


@pytest.mark.long
def test_a_browser_shows_the_episode_and_its_slider_seeks(dataset: Path, browser: Browser) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    with shown("replay", dataset / "ep_000001", "--web", "--port", "0", "--speed", "0.2") as page:
        browser.open(page.url)
        wait_until(lambda: "frame" in browser.text())
        times = set()

        def plays() -> bool:
            times.update(re.findall(r"(\d\.\d\d) s", browser.text()))
            return len(times) > 3

        wait_until(plays)
        browser.click("Pause")
        wait_until(lambda: "paused" in browser.text())
        browser.press("[role=slider]", "\ue011")  # Home
        wait_until(lambda: "0.00 s, paused" in browser.text())
        start = browser.screenshot()
        browser.press("[role=slider]", "\ue014" * 20)  # arrow right
        wait_until(lambda: f"{20 * 0.064:.2f} s, paused" in browser.text())
        wait_until(lambda: np.abs(browser.screenshot().astype(float) - start).max() > 50)
        assert page.end()[0] == 0


def test_mujocos_window_plays_the_episode(dataset: Path, screen: str) -> None:
    with shown("replay", dataset / "ep_000001", DISPLAY=screen, LIBGL_ALWAYS_SOFTWARE="1") as window:
        assert window.report["url"] is None
        time.sleep(2)
        assert window.still_runs()
        assert window.end() == (0, "", [])


def test_what_replays_bit_for_bit_is_what_was_recorded(dataset: Path) -> None:
    """The first row of a frame's actions is its `ctrl`, and the state its joints, in their own precision."""
    frame = load_frame((dataset / "ep_000000" / "lowdim" / "000025.pkl").read_bytes())
    np.testing.assert_array_equal(frame["sim_ctrl"][0].astype(np.float32), frame["ctrl"])
    np.testing.assert_array_equal(frame["sim_qpos"][:6].astype(np.float32), frame["joints"][:6])
    assert bool(frame["sim_magnet"][0]) is frame["magnet"] is True
