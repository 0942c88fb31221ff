"""An attempt's bytes: what a worker gives back."""

from __future__ import annotations

import platform
from importlib.metadata import version

from ... import __version__
from ..dataset.layout import lowdim_name
from ..dataset.lowdim import content_hash, dump_frame
from ..types import EpisodePayload
from .engine import Simulated
from .frames import frames
from .pictures import image_files
from .simulator import Simulator

# Revision of how scenes are drawn, raised when the same config gives other pictures: 2 since the table and the posts
# cast shadows. A recording that states none is of `FIRST_LOOKS`.
LOOKS, FIRST_LOOKS = "2", "1"

# Revision of the engine, raised when the same config and seed give other actions: 2 since all tasks are programs of
# skills, and arms solve inverse kinematics in closed form. A recording that states none is of `FIRST_ENGINE`.
ENGINE, FIRST_ENGINE = "2", "1"


def versions() -> dict[str, str]:
    """Versions of what an episode's bytes depend on; `looks` concerns its pictures alone."""
    packages = {name: name for name in ("mujoco", "mink", "daqp", "numpy")} | {"opencv": "opencv-python-headless"}
    return {"yamsim": __version__, "python": platform.python_version(), "looks": LOOKS, "engine": ENGINE} | {
        key: version(name) for key, name in packages.items()
    }


def payload(simulator: Simulator, done: Simulated) -> EpisodePayload:
    """All that is recorded of an attempt: its files, rendered, if it succeeded.

    Raises:
        ResourceError: no OpenGL context could be made.
    """
    if not done.outcome.success:
        return result(done)
    recorded = frames(simulator, done.attempt, done.states)
    files = {lowdim_name(k): dump_frame(frame) for k, frame in enumerate(recorded)}
    files |= image_files(simulator, done.attempt, [state.qpos for state in done.states])
    return EpisodePayload(
        done.attempt,
        done.outcome,
        files,
        len(recorded),
        content_hash(recorded),
        versions(),
        simulator.renderer.description,
    )


def result(done: Simulated) -> EpisodePayload:
    """What became of an attempt, without any files."""
    return EpisodePayload(done.attempt, done.outcome)
