"""Draw tasks at the start, middle and end of their expert's first success, into `docs/images/tasks/`.

python -m tools.task_pictures               # tasks that have a picture there
python -m tools.task_pictures tower         # or others
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image as Pillow

from yamsim_cli.core.config.session import Session
from yamsim_cli.session_opener import SessionOpener

if TYPE_CHECKING:
    from yamsim_cli.core.episode.execution import SimulatedAttempt
    from yamsim_cli.core.episode.simulator import Simulator

# px, scene camera's picture, and the shown rows and columns: the table between the arms
_SIZE, _ROWS, _COLUMNS = "480x360", slice(96, 276), slice(115, 365)
_COLOURS = 256
_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images" / "tasks"

# Attempts of seed 0, in which a success is searched.
_TRIES = 10


def main(names: list[str]) -> None:
    """Draw and write."""
    opener = SessionOpener(os.environ, lambda text: print(text, file=sys.stderr), str)
    # What draws is settled before anything imports MuJoCo.
    where = opener.choose_gl_backend(opener.find_locations())
    from yamsim_cli.core.config.recording import SCENE_CAMERA

    for name in names or sorted(file.stem for file in _FOLDER.glob("*.png")):
        config = opener.load_record_config("default", where, task=name, size=_SIZE, quality="high")
        with first_success(opener.with_scene_meshes(Session(config, where))) as success:
            seen = [of[SCENE_CAMERA][_ROWS, _COLUMNS] for of in pictures(*success, (0, 0.5, 1), (SCENE_CAMERA,))]
        file = _FOLDER / f"{name}.png"
        few_colours(np.hstack(seen)).save(file, optimize=True)
        sys.stdout.write(f"{file}: {file.stat().st_size} bytes\n")


@contextmanager
def first_success(session: Session) -> Iterator[tuple[Simulator, SimulatedAttempt]]:
    """Return the first success of seed 0, with its simulator."""
    from yamsim_cli.core.attempt_data import AttemptJob
    from yamsim_cli.core.episode.execution import simulate_expert
    from yamsim_cli.core.episode.sampling import sample_attempt
    from yamsim_cli.core.episode.simulator import SimulatorCache

    with SimulatorCache(session) as simulators:
        for job in (AttemptJob(0, number) for number in range(_TRIES)):
            simulator = simulators.get(job)
            done = simulate_expert(simulator, sample_attempt(simulator, job))
            if done.outcome.success:
                yield simulator, done
                return
    raise SystemExit(f"{session.config.task.name}: none of {_TRIES} attempts succeeded")


def pictures(
    simulator: Simulator, done: SimulatedAttempt, moments: Sequence[float], cameras: Sequence[str]
) -> list[dict[str, np.ndarray]]:
    """Return, for each moment, camera -> image (height, width, 3).

    Args:
        moments: shares of the attempt's frames, 0 for the first and 1 for the last one.
    """
    from yamsim_cli.core.episode.attempt_payload import render_cameras

    shown = [done.recorded_states[round(moment * (len(done.recorded_states) - 1))].qpos for moment in moments]
    return [render_cameras(simulator, done.attempt, qpos, cameras) for qpos in shown]


def few_colours(image: np.ndarray) -> Pillow.Image:
    """Return an image in 256 colours for a small PNG, dithered, since shadows would have edges otherwise."""
    return Pillow.fromarray(image).quantize(_COLOURS, dither=Pillow.Dither.FLOYDSTEINBERG)


if __name__ == "__main__":
    main(sys.argv[1:])
