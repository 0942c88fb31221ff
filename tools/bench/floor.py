"""Lower bound of an episode's cost: physics, rendering, encoding and writing, each alone."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from tests.attempts import all_actions
from tools.bench.setting import Stopwatch
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import SimulatedAttempt, simulate_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.writing import publish_directory
from yamsim_cli.core.images.jpeg import encode_jpeg


def floor_seconds(simulator: Simulator, done: SimulatedAttempt, place: Path) -> dict[str, float]:
    """Return part -> seconds for one episode.

    Args:
        place: an empty directory on the measured disk.
    """
    config, scene = simulator.config, simulator.scene
    physics, drawing, encoding, writing = (Stopwatch() for _ in range(4))
    with physics:
        simulate_actions(simulator, done.attempt, all_actions(done.recorded_states), EXPERT_RULES)
    data = mujoco.MjData(scene.model)
    width, height = config.image.size_px
    image = np.empty((height, width, 3), np.uint8)
    files = {}
    for k, (state, frame) in enumerate(
        zip(done.recorded_states, frame_records(simulator, done.attempt, done.recorded_states), strict=True)
    ):
        data.qpos[:] = state.qpos
        mujoco.mj_forward(scene.model, data)
        for camera in scene.cameras:
            with drawing:
                simulator.renderer.render(data, camera, image)
            with encoding:
                files[f"{camera}/{k}"] = encode_jpeg(image, config.image.jpeg_quality)
        files[f"lowdim/{k}"] = bytes(sum(getattr(value, "nbytes", 8) for value in frame.values()))
    with writing:
        publish_directory(place / "episode", files, place / "staging")
    return {
        "physics": physics.seconds,
        "drawing": drawing.seconds,
        "encoding": encoding.seconds,
        "writing": writing.seconds,
    }
