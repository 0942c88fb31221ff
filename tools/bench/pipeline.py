"""Recording as a whole: the plain pipeline (a), yamsim (b) and the lower bound (c), on the same episodes."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from tests.attempts import planned
from tools.bench.floor import floor_seconds
from tools.bench.pictures import Image, ssim
from tools.bench.plain import PlainPipeline, plain_setting
from tools.bench.setting import Stopwatch, setting
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.execution import SimulatedAttempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import process_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput

T = TypeVar("T")

QUALITIES = ("fast", "balanced")
WORKERS = (1, 2, 4)
# Every eighth frame is compared.
_COMPARED = 8
# On the disk of datasets.
_PLACE = "."


@dataclass(frozen=True)
class QualityFigures:
    """Figures of one quality.

    Attributes:
        floor_s: part -> median seconds per episode, done alone by one process.
        seconds_per_episode: workers -> seconds per episode, once each of them has delivered one.
        start_s: seconds until the first episode is on the disk, with one worker.
        ssim_plain, ssim_high: mean similarity to the pictures of the plain pipeline and of `high`.
    """

    floor_s: dict[str, float]
    seconds_per_episode: dict[int, float]
    start_s: float
    ssim_plain: float
    ssim_high: float

    @property
    def outside_floor(self) -> float:
        """Share of one worker's time outside the lower bound's parts."""
        return 1 - sum(self.floor_s.values()) / self.seconds_per_episode[1]


@dataclass(frozen=True)
class PipelineFigures:
    """Figures of recording.

    Attributes:
        plain_s: seconds per episode of the plain pipeline, whose OpenGL renders with a thread per core.
        plain_one_thread_s: the same with one thread, as a worker of yamsim renders.
        qualities: by name.
    """

    plain_s: float
    plain_one_thread_s: float
    qualities: dict[str, QualityFigures]


def first_successes(count: int) -> list[SimulatedAttempt]:
    """Return the first successful attempts of the recording's seed, in physics alone."""
    using = setting("fast")
    found: list[SimulatedAttempt] = []
    with Simulator(using) as simulator:
        for attempt in itertools.count():
            done = planned(simulator, using.config.seed, attempt)
            if done.outcome.success:
                found.append(done)
            if len(found) == count:
                break
    return found


def measure_pipeline(plain_episodes: int, episodes: int) -> PipelineFigures:
    """Run all three.

    Args:
        plain_episodes: episodes of the plain pipeline and of the lower bound.
        episodes: episodes of yamsim, for each quality and number of workers.
    """
    made = alone(first_successes, plain_episodes)
    plain_s, plain_images = alone(_plain, made, threads=None)
    one_thread_s, _ = alone(_plain, made[:1])
    high = alone(_rendered, "high", made)
    figures = PipelineFigures(plain_s, one_thread_s, {})
    for name in QUALITIES:
        ours = alone(_rendered, name, made)
        runs = {workers: _record(name, workers, episodes) for workers in WORKERS}
        figures.qualities[name] = QualityFigures(
            floor_s=alone(_floor, name, made),
            seconds_per_episode={workers: run[0] for workers, run in runs.items()},
            start_s=runs[1][1],
            ssim_plain=_likeness(ours, plain_images),
            ssim_high=_likeness(ours, high),
        )
    return figures


def alone(work: Callable[..., T], *args: object, threads: str | None = "0", **kwargs: object) -> T:
    """Run something in a process of its own, since Mesa decides once a process how many threads draw.

    Args:
        threads: of Mesa's software renderer, beside the process's own; None for Mesa's choice.
    """
    before = os.environ.pop("LP_NUM_THREADS", None)
    if threads is not None:
        os.environ["LP_NUM_THREADS"] = threads
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            return pool.submit(work, *args, **kwargs).result()
    finally:
        os.environ.pop("LP_NUM_THREADS", None)
        if before is not None:
            os.environ["LP_NUM_THREADS"] = before


def _plain(episodes: Sequence[SimulatedAttempt]) -> tuple[float, list[Image]]:
    using = plain_setting()
    images: list[Image] = []
    seconds = []
    with tempfile.TemporaryDirectory() as place:
        plain = PlainPipeline(using, build_scene(using))
        for k, done in enumerate(episodes):
            with Stopwatch() as watch:
                made = plain.make(done, Path(place, str(k)))
            seconds.append(watch.seconds)
            images += made[::_COMPARED]
        plain.close()
    return statistics.median(seconds), images


def _rendered(quality: str, episodes: Sequence[SimulatedAttempt]) -> list[Image]:
    """Render some of a quality's pictures of the scene camera."""
    with Simulator(setting(quality)) as simulator:
        return [
            image
            for done in episodes
            for state in done.recorded_states[::_COMPARED]
            for image in render_cameras(simulator, done.attempt, state.qpos, simulator.scene.cameras[:1]).values()
        ]


def _likeness(ours: Sequence[Image], theirs: Sequence[Image]) -> float:
    return statistics.mean(ssim(a, b) for a, b in zip(ours, theirs, strict=True))


def _floor(quality: str, episodes: Sequence[SimulatedAttempt]) -> dict[str, float]:
    with Simulator(setting(quality)) as simulator:
        parts = []
        for done in (episodes[0], *episodes):
            with tempfile.TemporaryDirectory(dir=_PLACE) as place:
                parts.append(floor_seconds(simulator, done, Path(place)))
    # The first one warmed up.
    return {name: statistics.median(part[name] for part in parts[1:]) for name in parts[0]}


def _record(quality: str, workers: int, episodes: int) -> tuple[float, float]:
    """Return seconds per episode once every worker has delivered one, and seconds until the first episode."""
    session = setting(quality).with_values(episodes=episodes + workers, workers=workers)
    came: list[float] = []

    def progress(done: int, wanted: int, attempts: int) -> None:
        came.extend([time.perf_counter()] * (done - len(came)))

    began = time.perf_counter()
    with tempfile.TemporaryDirectory(dir=_PLACE) as place:
        output = RecordingOutput(Path(place, "dataset"), ExistingDatasetMode.NEW)
        watch = RecordCallbacks(progress, lambda warning: None)
        record(session, output, process_executor, watch, StopRequest())
    return (came[-1] - came[workers - 1]) / episodes, came[0] - began
