"""Draw tasks at the start, middle and end of their expert's first success, into `docs/images/tasks/`.

python -m tools.task_pictures           # all that are shipped
python -m tools.task_pictures tower     # or some
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from yamsim_cli.core.opener import Opener
from yamsim_cli.core.session import Session

# Of the scene camera's picture, px, and what is shown of it: the table between the arms, rows and columns.
_SIZE, _ROWS, _COLUMNS = "480x360", slice(96, 276), slice(115, 365)
_COLOURS = 256
_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images" / "tasks"

# Attempts of seed 0 that are looked at for a success.
_TRIES = 10


def main(names: list[str]) -> None:
    """Draw and write."""
    opener = Opener(os.environ, sys.stderr.write, str)
    # What draws is settled before anything imports MuJoCo.
    where = opener.use_gl(opener.locations())
    from yamsim_cli.core.task_proof.tasks_there import tasks_there

    shipped = [task["name"] for task in tasks_there(where)]
    _FOLDER.mkdir(exist_ok=True)
    for name in names or shipped:
        config = opener.config("default", where, task=name, size=_SIZE, quality="high")
        pictures = _pictures(opener.with_meshes(Session(config, where)))
        # So few colours that the file stays small; dithered, or shadows would have edges.
        strip = Pillow.fromarray(np.hstack(pictures)).quantize(_COLOURS, dither=Pillow.Dither.FLOYDSTEINBERG)
        file = _FOLDER / f"{name}.png"
        strip.save(file, optimize=True)
        sys.stdout.write(f"{file}: {file.stat().st_size} bytes\n")


def _pictures(session: Session) -> list[np.ndarray]:
    """The scene camera's images (height, width, 3) of the first success."""
    from yamsim_cli.core.attempt.engine import demonstrate
    from yamsim_cli.core.attempt.pictures import render
    from yamsim_cli.core.attempt.sampling import sample
    from yamsim_cli.core.attempt.simulators import Simulators
    from yamsim_cli.core.config.recording import SCENE_CAMERA
    from yamsim_cli.core.types import EpisodeJob

    with Simulators(session) as simulators:
        for job in (EpisodeJob(0, number) for number in range(_TRIES)):
            simulator = simulators.of(job)
            done = demonstrate(simulator, sample(simulator, job))
            if done.outcome.success:
                shown = [done.states[k].qpos for k in (0, len(done.states) // 2, -1)]
                seen = [render(simulator, done.attempt, qpos, (SCENE_CAMERA,))[SCENE_CAMERA] for qpos in shown]
                return [image[_ROWS, _COLUMNS] for image in seen]
    raise SystemExit(f"{session.config.task.name}: none of {_TRIES} attempts succeeded")


if __name__ == "__main__":
    main(sys.argv[1:])
