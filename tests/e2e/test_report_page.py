"""The report in a real browser: complete, self-contained, in light and dark, wide and narrow."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.datasets.checks.sample import SampleDataset, episode
from tests.e2e.browser import Browser
from yamsim_cli.core.config.recording import RecordConfig

pytestmark = pytest.mark.slow

EVIL = "<img src=x onerror=document.title='pwned'>"


def evaluate(client: Browser, script: str) -> Any:
    return client.run(f"return {script}")


@pytest.fixture(params=["whole", "damaged", "empty"])
def page(request: pytest.FixtureRequest, tmp_path: Path, config: RecordConfig) -> tuple[str, Path]:
    sample = SampleDataset(config.data_config(), [episode(k) for k in range(8)])
    sample.fail(EVIL, layout={"banana": (0.5, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0)})
    sample.episodes[1].over["rig"] = EVIL
    if request.param == "empty":
        sample.episodes, sample.failures = [], []
    dataset = sample.write(tmp_path / "a dataset")
    if request.param == "damaged":
        shutil.rmtree(dataset / "ep_000003")
        for file in (dataset / "ep_000005/lowdim").iterdir():
            file.write_bytes(b"")
        (dataset / "ep_000002" / EVIL).touch()
        (dataset / "ep_000002" / ("unbreakable" * 20)).touch()
    run = yamsim("summarize", dataset, "--html", tmp_path / "report.html", "--json")
    assert run.code == (4 if request.param == "damaged" else 0), run.err
    return request.param, tmp_path / "report.html"


def test_the_page_is_drawn_whole_and_can_be_read(page: tuple[str, Path], browser: Browser) -> None:
    kind, file = page
    browser.open(file.as_uri())
    assert_drawn_from_nothing_but_itself(kind, browser)
    assert_light_dark_and_paper_can_be_read(browser)
    for width in (1200, 420):
        browser.devtools(
            "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
        )
        assert evaluate(browser, "document.documentElement.scrollWidth") <= width, "something sticks out"


def assert_drawn_from_nothing_but_itself(kind: str, browser: Browser) -> None:
    text = browser.text()
    assert "a dataset" in text
    assert evaluate(browser, "document.title") == "a dataset: dataset report"
    assert evaluate(browser, "document.scripts.length") == 0
    fetched = evaluate(browser, "performance.getEntriesByType('resource').map(entry => entry.name)")
    assert [name for name in fetched if not name.startswith("data:")] == []
    assert evaluate(browser, "[...document.images].filter(image => !image.naturalWidth).length") == 0
    assert evaluate(browser, "document.images.length") == (0 if kind == "empty" else 18)
    flat = "[...document.querySelectorAll('svg')].filter(s => s.getBoundingClientRect().height < 20).length"
    assert evaluate(browser, flat) == 0
    if kind != "empty":
        assert EVIL in text
        assert "banana, start" in text
    if kind == "damaged":
        assert "episode.missing" in text
        assert "lowdim.damaged" in text


def assert_light_dark_and_paper_can_be_read(browser: Browser) -> None:
    style = "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]"
    brightness = {}
    for media, scheme in (("screen", "light"), ("screen", "dark"), ("print", "dark")):
        browser.devtools(
            "Emulation.setEmulatedMedia", media=media, features=[{"name": "prefers-color-scheme", "value": scheme}]
        )
        colours = [
            np.mean([int(part) for part in colour.strip("rgb()").split(",")[:3]]) for colour in evaluate(browser, style)
        ]
        assert abs(colours[0] - colours[1]) > 150, (media, scheme)
        brightness[media, scheme] = colours[0]
        if media == "screen":
            assert browser.screenshot().mean() == pytest.approx(colours[0], abs=60)
    assert brightness["screen", "light"] > 240 > 60 > brightness["screen", "dark"]
    assert brightness["print", "dark"] > 240
