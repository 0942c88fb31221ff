"""Cost of an image and its similarity to a reference, by task, camera and quality.

MUJOCO_GL=egl python -m tools.bench.images [--quality fast --quality balanced,shadow_map_px=2048 ...] [--task NAME]

A quality is a name, or a name and changed keys. All qualities draw the same states, in turn, and the figures are CPU
time. Other load on the machine still slows memory and caches, so compare figures of one run alone.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from tests.attempts import planned
from tools.bench.pictures import Image, ssim
from tools.bench.setting import use_gl
from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.session_opener import SessionOpener

# Name of a case -> settings of its recording.
CASES: dict[str, dict[str, Any]] = {
    "pickplace": {"task": "pickplace", "wrist": True},
    "hang_mug": {"task": "hang_mug", "wrist": True},
    "tower": {"task": "tower", "wrist": True},
}
# As `fast` and `balanced`, but with sixteen samples a pixel and steps of 0.16 mm at edges of shadows.
REFERENCE = "fast,supersampling=4,shadow_map_px=8192,smooth_shadows=false"
_EVERY = 8  # frames between two compared images


@dataclass(frozen=True)
class ImageFigures:
    """Figures of one case, quality and camera.

    Attributes:
        cpu_s: mean CPU seconds of an image, or of all cameras' images of a state, for each pass over the episode.
        ssim: similarity of every eighth image to the reference.
    """

    cpu_s: list[float]
    ssim: list[float]


def open_case(settings: dict[str, Any], quality: str) -> Session:
    """Return the session of a case, rendered with a quality such as `fast,shadow_map_px=2048`."""
    name, *changes = quality.split(",")
    opener = SessionOpener(dict(os.environ), lambda line: None, str)
    opener.stay_offline()
    where = opener.find_locations()
    session = Session(opener.load_record_config("default", where, quality=name, **settings), where)
    changed = {key: yaml.safe_load(value) for key, _, value in (each.partition("=") for each in changes)}
    render = type(session.config.render).model_validate({**session.config.render.model_dump(), **changed})
    return opener.with_scene_meshes(session.with_values(render=render))


def _draw(simulator: Simulator, states: Sequence[Array], camera: str) -> tuple[list[float], list[Image]]:
    """Return the CPU time of each image of one camera, and every eighth image."""
    attempt, seconds, images = Attempt(AttemptJob(0, 0)), [], []
    for k, qpos in enumerate(states):
        began = time.process_time()
        (image,) = render_cameras(simulator, attempt, qpos, [camera]).values()
        seconds.append(time.process_time() - began)
        if k % _EVERY == 0:
            images.append(image)
    return seconds, images


def _all_cameras(simulator: Simulator, states: Sequence[Array]) -> list[float]:
    """Return the CPU time of the images of all cameras for each state."""
    attempt, seconds = Attempt(AttemptJob(0, 0)), []
    for qpos in states:
        began = time.process_time()
        render_cameras(simulator, attempt, qpos, simulator.scene.cameras)
        seconds.append(time.process_time() - began)
    return seconds


def measure(case: str, qualities: Sequence[str], passes: int, compare: bool) -> dict[tuple[str, str], ImageFigures]:
    """Return the figures of each quality and camera; "all" are the cameras together, for each state."""
    settings = CASES[case]
    with Simulator(open_case(settings, "fast")) as simulator:
        states = [state.qpos for state in planned(simulator, 0).recorded_states]
        cameras = simulator.scene.cameras
    wanted: dict[str, list[Image]] = {}
    if compare:
        with Simulator(open_case(settings, REFERENCE)) as simulator:
            attempt = Attempt(AttemptJob(0, 0))
            compared = [render_cameras(simulator, attempt, qpos, cameras) for qpos in states[::_EVERY]]
            wanted = {camera: [images[camera] for images in compared] for camera in cameras}
    simulators = {quality: Simulator(open_case(settings, quality)) for quality in qualities}
    figures = {(quality, camera): ImageFigures([], []) for quality in qualities for camera in (*cameras, "all")}
    for number in range(passes + 1):  # the first one warms up
        for quality, simulator in simulators.items():
            for camera in cameras:
                seconds, images = _draw(simulator, states, camera)
                if number:
                    figures[quality, camera].cpu_s.append(statistics.mean(seconds))
                elif compare:
                    pairs = zip(images, wanted[camera], strict=True)
                    figures[quality, camera].ssim.extend(ssim(a, b) for a, b in pairs)
            seconds = _all_cameras(simulator, states)
            if number:
                figures[quality, "all"].cpu_s.append(statistics.mean(seconds))
    for simulator in simulators.values():
        simulator.close()
    return figures


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quality", action="append", help="such as `fast` or `fast,shadow_map_px=2048`")
    parser.add_argument("--task", action="append", choices=list(CASES))
    parser.add_argument("--passes", type=int, default=3, help="over the episode, after one that warms up")
    parser.add_argument("--no-compare", action="store_true", help="leave out the similarity")
    options = parser.parse_args()
    use_gl()
    os.environ.setdefault("LP_NUM_THREADS", "0")  # as in `yamsim record`
    table = Table(title="CPU time of an image, and its similarity to one with exact shadows", title_justify="left")
    for column in ("case", "camera", "quality", "ms, median pass", "ms, least pass", "SSIM, mean", "SSIM, least"):
        table.add_column(column, justify="right" if column[0] in "mS" else "left", no_wrap=True)
    for case in options.task or CASES:
        figures = measure(case, options.quality or ["fast", "balanced"], options.passes, not options.no_compare)
        for (quality, camera), one in sorted(figures.items(), key=lambda item: item[0][1]):
            ms = [1000 * seconds for seconds in one.cpu_s]
            likeness = (f"{np.mean(one.ssim):.4f}", f"{min(one.ssim):.4f}") if one.ssim else ("", "")
            table.add_row(case, camera, quality, f"{statistics.median(ms):.1f}", f"{min(ms):.1f}", *likeness)
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
