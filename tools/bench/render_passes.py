"""Where the CPU time of an image goes: passes of the renderer, and shares of vertices and pixels.

MUJOCO_GL=egl python -m tools.bench.render_passes [--quality fast --quality balanced] [--task NAME] [--states N]

OpenGL draws when it is asked for pixels, so each pass here ends with `glFinish`. That makes an image a little dearer.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tests.attempts import planned
from tools.bench.images import CASES, open_case
from tools.bench.setting import use_gl
from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.rendering.incremental_renderer import IncrementalRenderer
from yamsim_cli.core.rendering.pixel_boxes import ScissorBox
from yamsim_cli.core.rendering.renderer import SceneRenderer

# Pass -> method of a class, and whether it calls OpenGL.
_PASSES: dict[str, tuple[type, str, bool]] = {
    "update of the scene": (SceneRenderer, "_update_scene", False),
    "what has changed": (IncrementalRenderer, "_changed_pixel_box", False),
    "appearance": (IncrementalRenderer, "_read_appearance", False),
    "shadow map": (IncrementalRenderer, "_update_shadow_map", True),
    "geoms, lights and sky": (IncrementalRenderer, "_draw_image", True),
    "averaging, flipping": (SceneRenderer, "_average_pixels", False),
}
_ONE_PIXEL = ScissorBox(0, 0, 1, 1)


@contextmanager
def replaced(owner: type, name: str, make: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Iterator[None]:
    """Replace a method by `make(method)` in the block."""
    before = getattr(owner, name)
    setattr(owner, name, make(before))
    try:
        yield
    finally:
        setattr(owner, name, before)


def timed(seconds: dict[str, float], label: str, opengl: bool) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that adds the CPU seconds of a method to `seconds[label]`."""
    from OpenGL import GL

    def wrap(method: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            if opengl:
                GL.glFinish()
            began = time.process_time()
            result = method(*arguments)
            if opengl:
                GL.glFinish()
            seconds[label] += time.process_time() - began
            return result

        return run

    return wrap


def draw_all(simulator: Simulator, states: Sequence[Array]) -> float:
    """Draw all cameras in each state, and return CPU seconds an image."""
    attempt, began = Attempt(AttemptJob(0, 0)), time.process_time()
    for qpos in states:
        render_cameras(simulator, attempt, qpos, simulator.scene.cameras)
    return (time.process_time() - began) / len(states) / len(simulator.scene.cameras)


def measure(case: str, quality: str, count: int) -> dict[str, float]:
    """Return label -> CPU seconds an image."""
    with Simulator(open_case(CASES[case], quality)) as simulator:
        episode = [state.qpos for state in planned(simulator, 0).recorded_states]
        states = [episode[k] for k in np.linspace(5, len(episode) - 1, count).astype(int)]
        draw_all(simulator, states)
        figures = {"image": min(draw_all(simulator, states) for _ in range(3))}
        images = count * len(simulator.scene.cameras)
        for label, (owner, name, opengl) in _PASSES.items():
            figures[label] = _least(simulator, states, owner, name, opengl) / images
        figures["of the geoms: vertices and calls"] = _vertices(simulator, states) / images
        figures["of the geoms: each pixel once"] = _once(simulator, states) / images
    return figures


def _least(simulator: Simulator, states: Sequence[Array], owner: type, name: str, opengl: bool) -> float:
    """Return the CPU seconds of a method over all states, the least of three passes."""
    found = []
    for _ in range(3):
        seconds: dict[str, float] = defaultdict(float)
        with replaced(owner, name, timed(seconds, name, opengl)):
            draw_all(simulator, states)
        found.append(seconds[name])
    return min(found)


def _vertices(simulator: Simulator, states: Sequence[Array]) -> float:
    """Return the CPU seconds of the same geoms with one visible pixel."""

    def into_one_pixel(method: Callable[..., Any]) -> Callable[..., Any]:
        return lambda self, view, box, *others: method(self, view, _ONE_PIXEL, *others)

    with replaced(IncrementalRenderer, "_draw_image", into_one_pixel):
        return _least(simulator, states, IncrementalRenderer, "_draw_image", True)


def _once(simulator: Simulator, states: Sequence[Array]) -> float:
    """Return the CPU seconds of planes, the table and the sky alone, which cover almost every pixel about once."""

    def background(method: Callable[..., Any]) -> Callable[..., Any]:
        def run(self: Any, view: Any, box: Any, drawn: Any, light: Any) -> Any:
            layout = self._layout
            standing = np.union1d(np.flatnonzero(layout.is_plane), layout.shadow_tables)
            return method(self, view, box, np.intersect1d(drawn, standing), light)

        return run

    with replaced(IncrementalRenderer, "_draw_image", background):
        return _least(simulator, states, IncrementalRenderer, "_draw_image", True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quality", action="append", help="such as `fast` or `fast,shadow_map_px=2048`")
    parser.add_argument("--task", action="append", choices=list(CASES))
    parser.add_argument("--states", type=int, default=20, help="of one episode")
    options = parser.parse_args()
    use_gl()
    os.environ.setdefault("LP_NUM_THREADS", "0")  # as in `yamsim record`
    cv2.setNumThreads(1)
    columns = [(case, quality) for case in options.task or CASES for quality in options.quality or ["fast", "balanced"]]
    found = [measure(case, quality, options.states) for case, quality in columns]
    table = Table(title="CPU time of an image, ms, mean of all cameras", title_justify="left")
    table.add_column("pass")
    for case, quality in columns:
        table.add_column(f"{case}, {quality}", justify="right")
    for label in found[0]:
        table.add_row(label, *(f"{1000 * figures[label]:.2f}" for figures in found))
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
