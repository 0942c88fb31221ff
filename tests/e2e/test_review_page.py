"""The review page in a real browser: overview, filter, brush, decide by keyboard, and what remains afterwards."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import yamsim_cli
from tests.cli.run_cli import yamsim
from tests.core.dataset.making import made, write_dataset
from tests.e2e.browser import Browser, wait_until
from yamsim_cli.selection import read_selection

pytestmark = pytest.mark.slow

EPISODES = 30


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "dataset", *(made(k) for k in range(EPISODES)))


@contextmanager
def served(dataset: Path, *flags: str) -> Iterator[str]:
    command = [sys.executable, "-m", "yamsim_cli", "review", dataset, "--port", "0", *flags]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[0]
    finally:
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(30) == 0


def open_page(browser: Browser, url: str) -> None:
    browser.devtools("Emulation.setDeviceMetricsOverride", width=1366, height=768, deviceScaleFactor=1, mobile=False)
    browser.open(url)
    wait_until(lambda: browser.run("return document.body.dataset.ready"), 60)


def counted(browser: Browser) -> str:
    return str(browser.run("return document.getElementById('counts').textContent"))


def until_counted(browser: Browser, part: str) -> None:
    wait_until(lambda: part in counted(browser), 120)


def test_a_person_decides_by_keyboard(browser: Browser, dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "ann.yaml"
    with served(dataset, "--reviewer", "ann", "--out", str(file)) as url:
        open_page(browser, url)
        until_counted(browser, f"{EPISODES} of {EPISODES} shown")
        assert browser.run("return document.documentElement.scrollWidth") <= 1366
        broken = "return [...document.images].filter(i => i.src && i.complete && !i.naturalWidth).length"
        wait_until(lambda: browser.run("return document.images[0].complete && document.images[0].naturalWidth"), 120)
        assert browser.run(broken) == 0
        unnamed = "return [...document.querySelectorAll('button,input,select,canvas')].filter(e => !(e.ariaLabel || e.labels?.length || e.textContent.trim() || e.hidden)).map(e => e.outerHTML)"  # noqa: E501
        assert [text for text in browser.run(unnamed) if 'hidden=""' not in text and "spacer" not in text] == []
        browser.keys("k\ue014d")  # keep the first, go right, drop the second
        until_counted(browser, "1 keep · 1 drop")
        browser.keys("u")
        until_counted(browser, "1 keep · 0 drop")
        browser.keys("d\ue007")  # drop again, open
        wait_until(lambda: "frame 0 of 3" in browser.text(), 120)
        browser.keys("\ue014[")  # one frame on, trim the beginning
        wait_until(lambda: "frames 1 to the last" in browser.text(), 120)
        browser.keys("\ue00c")  # back
        brush_left_half(browser)
        shown = int(re.match(r"(\d+) of", counted(browser))[1])  # type: ignore[index]
        assert 0 < shown < EPISODES
        browser.run("document.getElementById('search').value='7';"
                    "document.getElementById('search').dispatchEvent(new Event('input'))")  # fmt: skip
        until_counted(browser, "1 of")
    decided = read_selection(file).decisions
    assert {k: (d.decision, d.first_frame, d.reviewer) for k, d in decided.items()} == {
        0: ("keep", None, "ann"), 1: ("drop", 1, "ann"),
    }  # fmt: skip
    with served(dataset, "--out", str(file)) as url:
        open_page(browser, url)
        until_counted(browser, "1 keep · 1 drop")
    assert len(yamsim_cli.open_dataset(dataset, selection=file)) == EPISODES - 1
    bob = tmp_path / "bob.yaml"
    bob.write_text(file.read_text().replace('"drop"', '"keep"').replace("ann", "bob"))
    run = yamsim("review", "--merge", file, bob, "--out", tmp_path / "both.yaml")
    assert (run.code, "conflict in ep_000001" in run.out) == (6, True)


def brush_left_half(browser: Browser) -> None:
    box = browser.run(
        "const b = document.getElementById('plot').getBoundingClientRect(); return [b.x, b.y, b.width, b.height]"
    )
    x, y, width, height = box
    browser.drag((x + 46, y + 5), (x + width / 2, y + height - 25))
    wait_until(lambda: not counted(browser).startswith(f"{EPISODES} of"), 120)


def test_two_episodes_side_by_side(browser: Browser, dataset: Path) -> None:
    with served(dataset) as url:
        open_page(browser, url)
        browser.keys("\ue007")  # open the first
        wait_until(lambda: "frame 0 of 3" in browser.text(), 120)
        browser.keys("c\ue00c\ue014\ue007")  # compare, back, right, open
        wait_until(
            lambda: browser.run("return document.getElementById('episode-title').textContent") == "Episode 1", 30
        )
        left = (
            "return ['cameras', 'pinned'].map(id => document.querySelector(`#${id} canvas`)?.getBoundingClientRect().x)"
        )
        wait_until(lambda: None not in browser.run(left), 120)
        here, there = browser.run(left)
        assert here < there
        assert "Episode 0, 4 frames" in browser.text()
        assert browser.run("return document.documentElement.scrollWidth") <= 1366
        assert "faint: the joints of episode 0" in browser.run("return document.getElementById('timeline').ariaLabel")
        wait_until(lambda: "frame 0 of 3" in browser.text(), 120)
        # The same key pins this one.
        browser.keys("\ue014")
        wait_until(lambda: "frame 1 of 3" in browser.text(), 120)
        browser.keys("c")
        wait_until(lambda: "Episode 1, 4 frames" in browser.text(), 120)
        browser.keys("c")
        wait_until(lambda: browser.run("return document.getElementById('pinned-side').hidden"), 120)


def test_nothing_of_an_episode_is_shown_while_the_next_one_loads(browser: Browser, dataset: Path) -> None:
    with served(dataset) as url:
        open_page(browser, url)
        browser.keys("\ue007")  # open the first
        wait_until(lambda: "frame 0 of 3" in browser.text(), 120)
        browser.run(
            "const own = fetch; window.faults = []; window.addEventListener('error', e => faults.push(e.message));"
            "window.fetch = async (path) => {"
            " if (path.startsWith('/api/episode/')) await new Promise((go) => { window.answer = go; });"
            " return own(path); }"
        )
        browser.keys("\ue00c\ue014\ue007")  # back, right, open
        wait_until(lambda: browser.run("return Boolean(window.answer)"), 30)
        assert browser.run("return document.getElementById('episode-title').textContent") == "Episode 1"
        assert browser.run("return document.querySelectorAll('#cameras canvas').length") == 0
        assert browser.run("return ['time', 'facts', 'legend'].map(id => document.getElementById(id).textContent)") == [
            "", "", "",
        ]  # fmt: skip
        browser.run("document.getElementById('timeline').dispatchEvent(new PointerEvent('pointermove', {buttons: 1}));")
        assert browser.run("return faults") == []
        browser.run("answer()")
        wait_until(lambda: "frame 0 of 3" in browser.text(), 120)


@pytest.mark.long
def test_a_scene_that_cannot_be_played_is_told(browser: Browser, dataset: Path) -> None:
    """The stubs have no config that `yamsim replay` can simulate."""
    with served(dataset) as url:
        open_page(browser, url)
        browser.keys("\ue007s")
        wait_until(lambda: "the 3D scene cannot be shown" in browser.text(), 120)


def test_a_second_page_is_told(browser: Browser, dataset: Path) -> None:
    with served(dataset) as url:
        open_page(browser, url)
        hidden: Callable[[], bool] = lambda: browser.run("return document.getElementById('other').hidden")  # noqa: E731
        wait_until(hidden, 10)
        # Another page takes over, as a second tab would.
        browser.run(f"fetch('{url}api/claim', {{method: 'POST', body: JSON.stringify({{take_over: true}})}})")
        wait_until(lambda: not hidden(), 20)
        browser.keys("d")
        wait_until(lambda: "another page is open" in browser.text(), 20)
    assert not (dataset / "selection.yaml").exists()


def test_both_colour_schemes_can_be_read(browser: Browser, dataset: Path) -> None:
    with served(dataset) as url:
        open_page(browser, url)
        for scheme in ("light", "dark"):
            browser.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            style = "const s = getComputedStyle(document.body); return [s.backgroundColor, s.color]"
            paper, ink = (np.mean([int(v) for v in re.findall(r"\d+", text)[:3]]) for text in browser.run(style))
            assert (paper - ink > 150) if scheme == "light" else (ink - paper > 150)
