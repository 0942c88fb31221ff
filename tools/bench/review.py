"""The review page on many episodes: time to open, scrolling, memory, and seconds for a decision, in Chromium.

Run `python -m tools.bench.review --episodes 10000`. The episodes are stubs: four frames and one camera of 320 x 240.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

from tests.core.dataset.making import CAMERA, CONFIG, FRAMES, HandmadeEpisode, frame, made, publish
from tests.e2e.browser import CHROMEDRIVER, CHROMIUM_ARGS, Browser, answers, wait_until
from yamsim_cli.core.dataset.dataset_paths import image_path, lowdim_path
from yamsim_cli.core.dataset.lowdim import content_hash, dump_frame
from yamsim_cli.core.dataset.records import file_hashes
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.rendering.view_cameras import resize_area

_CONTENTS = 20  # different pictures and motions, which the episodes share
_SCROLL_S = 6.0  # s of scrolling at each speed
_SPEEDS = (20, 112, 1000)  # px of a frame: a slow wheel, one row, dragging the scroll bar
_DECISIONS = 60  # of the scripted reviewer

# Scrolls by a number of pixels in each frame, and returns the milliseconds between frames.
_SCROLL = """
const [step, seconds] = arguments, grid = document.getElementById('grid'), times = [];
return new Promise((done) => {
  let sign = 1;
  const began = performance.now();
  const turn = (now) => {
    times.push(now);
    if (grid.scrollTop + grid.clientHeight >= grid.scrollHeight - 2) sign = -1;
    if (grid.scrollTop <= 0) sign = 1;
    grid.scrollTop += sign * step;
    if (performance.now() - began < 1000 * seconds) requestAnimationFrame(turn);
    else done(times.slice(1).map((time, k) => time - times[k]));
  };
  requestAnimationFrame(turn);
});
"""
# Goes to the next episode by priority, waits for its pictures, decides, and waits until that is confirmed.
_DECIDE = """
const [count] = arguments, times = [],
  press = (key) => document.body.dispatchEvent(new KeyboardEvent('keydown', {key, bubbles: true}));
const find = (id) => document.getElementById(id), frame = () => new Promise(requestAnimationFrame);
const drawn = () => [...document.querySelectorAll('#cameras canvas')].some((canvas) =>
  canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(Boolean));
return (async () => {
  for (let k = 0; k < count; k++) {
    const began = performance.now(), title = find('episode-title').textContent, before = find('counts').textContent;
    find('cameras').replaceChildren();
    press('j');
    while (find('episode-title').textContent === title || !drawn()) await frame();
    press(k % 4 ? 'k' : 'd');
    while (find('counts').textContent === before) await frame();
    times.push((performance.now() - began) / 1000);
  }
  press('Escape');
  return times;
})();
"""


@dataclass(frozen=True)
class ReviewFigures:
    """Figures of the page.

    Attributes:
        start_s, start_cpu_s: seconds from the command until it prints the page's address, and its processor time.
        usable_s: seconds from opening the page until its grid can be used, and its first film strip is shown.
        frames_per_s: pixels of a step -> frames per second while scrolling, and processor time of all of Chromium's
            processes for a frame, ms.
        page_mb, server_mb: memory of the page's JavaScript and of the server, before and after scrolling, MB.
        decision_s: median and largest seconds of a decision of the scripted reviewer.
    """

    start_s: float
    start_cpu_s: float
    usable_s: float
    frames_per_s: dict[int, tuple[float, float]]
    page_mb: tuple[float, float]
    server_mb: tuple[float, float]
    decision_s: tuple[float, float]


def stub(number: int, content: HandmadeEpisode) -> HandmadeEpisode:
    """Return an episode with the files of another one, and its own number, start, distance and length."""
    rng = np.random.default_rng(number)
    x, y = rng.uniform((0.25, -0.2), (0.45, 0.2))
    record = content.record.model_copy(
        update={
            "episode": number,
            "attempt": number,
            "layout": {**content.record.layout, "banana": (float(x), float(y), 0.02, 1.0, 0.0, 0.0, 0.0)},
            "outcome": content.record.outcome.model_copy(update={"dxy_m": float(rng.gamma(2, 0.005))}),
        }
    )
    return HandmadeEpisode(record, content.files)


def picture(seed: int) -> bytes:
    """Return a JPEG of 320 x 240 of coloured areas, as large as a rendered one."""
    coarse = np.random.default_rng(seed).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    return encode_jpeg(resize_area(coarse, 320, 240), 90)


def content(seed: int) -> HandmadeEpisode:
    """Return an episode with pictures of 320 x 240."""
    frames = [frame(k, seed) for k in range(FRAMES)]
    files = {lowdim_path(k): dump_frame(data) for k, data in enumerate(frames)}
    files |= {image_path(CAMERA, k): picture(10 * seed + k) for k in range(FRAMES)}
    values = {"cameras": {CAMERA: (320, 240)}, "content_sha256": content_hash(frames), "files": file_hashes(files)}
    return HandmadeEpisode(made(seed).record.model_copy(update=values), files)


def write_stubs(path: Path, episodes: int) -> None:
    """Write a dataset of stubs. Nothing waits for the disk."""
    contents = [content(seed) for seed in range(_CONTENTS)]
    with patch("os.fsync"), DatasetWriter(path, CONFIG, ExistingDatasetMode.NEW) as writer:
        for number in range(episodes):
            publish(writer, stub(number, contents[number % _CONTENTS]))
        writer.write_manifest()


@contextmanager
def _served(dataset: Path) -> Iterator[tuple[str, int, float]]:
    """Yield the page's address, the server's process id, and the seconds of its start."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "yamsim_cli", "review", str(dataset), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().split()[0]
        yield url, process.pid, time.perf_counter() - began
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


@contextmanager
def _browser(folder: Path) -> Iterator[tuple[Browser, int]]:
    """Yield a browser and the process id of its driver."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    driver = subprocess.Popen([CHROMEDRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: answers(port), 60)
        args = [arg for arg in CHROMIUM_ARGS if "swiftshader" not in arg]
        browser = Browser(port, folder / "profile", [*args, "--disable-gpu"])
        try:
            yield browser, driver.pid
        finally:
            browser.close()
    finally:
        driver.terminate()
        driver.wait(60)


def _page_mb(browser: Browser) -> float:
    browser.devtools("HeapProfiler.collectGarbage")
    metrics = browser.devtools("Performance.getMetrics")["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "JSHeapUsedSize")) / 1e6


def _server_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _cpu_s(root: int) -> float:
    """Return the processor time of a process and of all its descendants, s."""
    parents, ticks = {}, {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = entry.read_text().rpartition(")")[2].split()
            parents[int(entry.parent.name)] = int(fields[1])
            ticks[int(entry.parent.name)] = int(fields[11]) + int(fields[12])

    def descends(pid: int) -> bool:
        return pid == root or (pid in parents and descends(parents[pid]))

    return sum(ticks[pid] for pid in ticks if descends(pid)) / os.sysconf("SC_CLK_TCK")


def _scroll(browser: Browser, driver: int, step: int) -> tuple[float, float]:
    before = _cpu_s(driver)
    times = browser.run(_SCROLL, step, _SCROLL_S)
    return 1000 / statistics.mean(times), 1000 * (_cpu_s(driver) - before) / len(times)


def measure(dataset: Path, folder: Path, decisions: int) -> ReviewFigures:
    """Open the page in Chromium, scroll, and decide."""
    with ExitStack() as stack:
        browser, driver = stack.enter_context(_browser(folder))
        browser.devtools(
            "Emulation.setDeviceMetricsOverride", width=1366, height=768, deviceScaleFactor=1, mobile=False
        )
        url, pid, start_s = stack.enter_context(_served(dataset))
        start_cpu_s = _cpu_s(pid)
        browser.open(url)
        shown = "const i = document.images[0]; return document.body.dataset.ready && i.complete && i.naturalWidth"
        wait_until(lambda: browser.run(shown), 300)
        usable_s = browser.run(
            "const ends = performance.getEntriesByType('resource').filter(e => e.name.includes('/strip/'));"
            "return Math.min(...ends.map(e => e.responseEnd)) / 1000"
        )
        browser.devtools("Performance.enable")
        before = _page_mb(browser), _server_mb(pid)
        frames = {step: _scroll(browser, driver, step) for step in _SPEEDS}
        after = _page_mb(browser), _server_mb(pid)
        seconds = browser.run(_DECIDE, decisions)
    return ReviewFigures(
        start_s,
        start_cpu_s,
        usable_s,
        frames,
        (before[0], after[0]),
        (before[1], after[1]),
        (statistics.median(seconds), max(seconds)),
    )


def _lines(figures: ReviewFigures) -> Iterator[str]:
    yield f"start of the command         {figures.start_s:.2f} s; processor time {figures.start_cpu_s:.2f} s"
    yield f"page usable                 {figures.usable_s:.2f} s"
    for step, (rate, cpu_ms) in figures.frames_per_s.items():
        yield f"scrolling {step:>5} px a frame   {rate:.1f} frames/s, {cpu_ms:.1f} ms of processor time a frame"
    for name, (before, after) in (("page", figures.page_mb), ("server", figures.server_mb)):
        yield f"memory of the {name:<14}{before:.1f} MB, after scrolling {after:.1f} MB"
    median, largest = figures.decision_s
    yield f"a decision                  median {median:.2f} s, at most {largest:.2f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=10_000)
    parser.add_argument("--decisions", type=int, default=_DECISIONS)
    parser.add_argument("--dataset", type=Path, help="where the stubs are kept; written if missing")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="review-bench-") as scratch:
        dataset = given.dataset or Path(scratch) / "stubs"
        if not dataset.exists():
            write_stubs(dataset, given.episodes)
        (dataset / "selection.yaml").unlink(missing_ok=True)
        figures = measure(dataset, Path(scratch), given.decisions)
    print("\n".join(_lines(figures)))


if __name__ == "__main__":
    main()
