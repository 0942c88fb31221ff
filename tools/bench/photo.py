"""Time, brightness, repeatability and outlines of images of quality `photo`, beside `high` and OpenGL's masks.

    MUJOCO_GL=egl python -m tools.bench.photo

Outlines are those of arms and objects before an empty background. The distance of two outlines is the area between
them for each pixel of their length. OpenGL's outline comes from a mask four times as fine.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tests.attempts import planned
from tools.bench.images import CASES, open_case
from tools.bench.setting import use_gl
from yamsim_cli.camera_rendering import HIDDEN_GROUP, QualityRenderer
from yamsim_cli.core.config.rendering import ImageConfig, RenderConfig
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.rendering.renderer import SceneRenderer

SIZES = ((640, 480), (128, 96))
FINER = 4  # rendered pixels per pixel along a side, of OpenGL's outline
_BLOCK = 16  # px, edge of the parts of an image whose worst one is reported
_MIN_LENGTH = 8.0  # px of outline in a block that counts


@dataclass(frozen=True)
class OutlineDistance:
    """Distance of the outlines of two renderers, px: over an image, and in its worst block of 16 x 16 px."""

    mean: float
    worst: float


def outline_distance(simulator: Simulator, qpos: Array, camera: str, size: tuple[int, int]) -> OutlineDistance:
    """Compare the outlines of arms and objects in an image of `photo` with those of OpenGL's mask.

    Changes the model of the simulator.
    """
    model, data = simulator.scene.model, simulator.state_replay.data
    model.geom_group[model.geom_bodyid == 0] = HIDDEN_GROUP
    model.light_active[:] = model.vis.headlight.active = 0
    (sky,) = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    start = int(model.tex_adr[sky])
    model.tex_data[start : start + 3 * int(model.tex_width[sky] * model.tex_height[sky])] = 255
    fine = (FINER * size[0], FINER * size[1])
    buffer = model.vis.global_
    buffer.offwidth, buffer.offheight = fine
    simulator.state_replay.set_state(qpos)
    with SceneRenderer(model, fine) as renderer:
        mask = (renderer.render_geom_ids(data, camera) >= 0).astype(np.float32)
    wanted = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_AREA), np.float32)
    with QualityRenderer(model, size, simulator.config.render) as renderer:
        # All surfaces are black, and the background is white.
        encoded = renderer.render(data, camera)[..., 0] / 255
    seen = 1 - np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    length = np.hypot(*np.gradient(cv2.GaussianBlur(wanted, (5, 5), 1.0)))
    between, lengths = (_block_sums(values) for values in (np.abs(seen - wanted), length))
    counted = lengths >= _MIN_LENGTH
    return OutlineDistance(
        float(between.sum() / lengths.sum()), float((between[counted] / lengths[counted]).max(initial=0.0))
    )


def _block_sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    height, width = (side // _BLOCK * _BLOCK for side in values.shape)
    blocks = values[:height, :width].reshape(height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK)
    return np.asarray(blocks.sum(axis=(1, 3)))


def _cpu_seconds(simulator: Simulator) -> float:
    """Return the CPU time of this process and of Filament's."""
    filament = getattr(simulator.renderer, "_filament", None)
    if filament is None or filament._process is None:
        return time.process_time()
    fields = Path(f"/proc/{filament._process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return time.process_time() + (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _render(simulator: Simulator, states: Sequence[Array], camera: str) -> tuple[float, list[NDArray[np.uint8]]]:
    """Return the median CPU seconds of an image, and the images of all states."""
    images, seconds = [], []
    for qpos in (states[0], *states):  # the first one warms up
        simulator.state_replay.set_state(qpos)
        began = _cpu_seconds(simulator)
        images.append(simulator.renderer.render(simulator.state_replay.data, camera).copy())
        seconds.append(_cpu_seconds(simulator) - began)
    return float(np.median(seconds[1:])), images[1:]


def _open(case: str, quality: str, size: tuple[int, int], **changes: object) -> Simulator:
    session = open_case(CASES[case], quality)
    image = ImageConfig(size_px=size, jpeg_quality=session.config.image.jpeg_quality)
    render: RenderConfig = session.config.render.model_copy(update=changes)
    return Simulator(session.with_values(image=image, render=render))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", action="append", choices=list(CASES))
    parser.add_argument("--states", type=int, default=4, help="of an episode")
    options = parser.parse_args()
    use_gl()
    os.environ.setdefault("LP_NUM_THREADS", "0")  # as in `yamsim record`
    table = Table(title="Images of quality photo", title_justify="left")
    for column in ("case", "camera", "size", "s photo", "s high", "median photo", "median high", "equal", "outline px"):
        table.add_column(column, no_wrap=True)
    for case in options.task or CASES:
        with _open(case, "fast", SIZES[0]) as simulator:
            every = [state.qpos for state in planned(simulator, 0).recorded_states]
            states = every[:: max(1, len(every) // options.states)][: options.states]
            cameras = simulator.scene.cameras
        for size in SIZES:
            for camera in cameras:
                with _open(case, "photo", size) as photo, _open(case, "high", size) as high:
                    seconds, images = _render(photo, states, camera)
                    _, again = _render(photo, states, camera)
                    equal = all((one == other).all() for one, other in zip(images, again, strict=True))
                    high_seconds, wanted = _render(high, states, camera)
                    found = [outline_distance(photo, qpos, camera, size) for qpos in states]
                medians = [f"{np.median(np.stack(each)):.0f}" for each in (images, wanted)]
                outline = f"{np.mean([one.mean for one in found]):.2f}, worst {max(one.worst for one in found):.2f}"
                row = (case, camera, f"{size[0]}x{size[1]}", f"{seconds:.2f}", f"{high_seconds:.2f}", *medians)
                table.add_row(*row, "yes" if equal else "no", outline)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
