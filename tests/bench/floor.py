"""What an episode costs at the very least: physics, drawing, encoding and writing, each done alone."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from tests.bench.setting import Setting, Stopwatch
from yamsim_cli.core.attempt.runner import EpisodeRunner
from yamsim_cli.core.files import publish_directory
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.sim.rollout import Rollout, simulate
from yamsim_cli.core.tasks.plans import phases
from yamsim_cli.core.types import Actions


def actions_of(rollout: Rollout) -> Actions:
    """Everything that acted in an episode, tick by tick."""
    acting = [state.actions for state in rollout.states]
    return Actions(
        np.concatenate([part.ctrl for part in acting]),
        tuple(on for part in acting for on in part.magnet),
        np.concatenate([part.joints for part in acting]),
    )


def floor_seconds(using: Setting, runner: EpisodeRunner, rollout: Rollout, place: Path) -> dict[str, float]:
    """Part -> seconds for one episode.

    Args:
        place: an empty directory on the disk that is written to.
    """
    config, scene = using.config, runner.scene
    physics, drawing, encoding, writing = (Stopwatch() for _ in range(4))
    with physics:
        held = [phases(config.task, config.grasp)]
        simulate(scene, rollout.states[0].qpos, actions_of(rollout), config.task.object.name, config.task.timing, held)
    data = mujoco.MjData(scene.model)
    width, height = config.image.size_px
    image = np.empty((height, width, 3), np.uint8)
    files = {}
    for k, (state, frame) in enumerate(zip(rollout.states, runner.frames(rollout.states), strict=True)):
        data.qpos[:] = state.qpos
        mujoco.mj_forward(scene.model, data)
        for camera in scene.cameras:
            with drawing:
                runner.renderer.draw(data, camera, image)
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
