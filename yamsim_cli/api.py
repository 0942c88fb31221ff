"""yamsim from Python: what the commands do, as functions that return what they found.

Errors are `yamsim_cli.core.errors.YamsimError`, with the text that the command line would show.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .commands.session import job_flags, locations, record_config, scene_meshes, skip_gl, use_gl

if TYPE_CHECKING:
    from .core.dataset.reader import StoredEpisode
    from .core.jobs.record import RecordReport


def record(
    out: str | Path,
    episodes: int = 1,
    *,
    seed: int | None = None,
    workers: int | None = None,
    wrist: bool | None = None,
    size: tuple[int, int] | None = None,
    quality: str | None = None,
    rig: str | None = None,
    task: str | None = None,
    grasp: str | None = None,
    config: str = "default",
    resume: bool = False,
) -> RecordReport:
    """Record successful episodes into a new dataset, as `yamsim record` does; the bytes are the same.

    Args:
        workers: processes to start, from a script that guards its main part by `if __name__ == "__main__"`; without,
            everything is done in this process.
        size: width and height of images, px.
        resume: continue the dataset that is at `out`.

    Returns:
        path, episodes, attempts, seconds.
    """
    flags = job_flags(rig=rig, task=task, n=episodes, workers=workers or 1, seed=seed, grasp=grasp) | {
        "wrist": (("wrist",), wrist),
        "size": (("image", "size_px"), size),
        "quality": (("render",), quality),
    }
    record_config(config, locations(), flags)
    where = use_gl(locations(), workers=workers is not None)
    settings = record_config(config, where, flags)

    from .core.dataset.opening import OpenMode
    from .core.jobs.collect import Watch
    from .core.jobs.destination import Output
    from .core.jobs.executors import LocalProcesses
    from .core.jobs.inline import ThisProcess
    from .core.jobs.record import record as run
    from .core.jobs.stop import Stop

    output = Output(Path(out), OpenMode.RESUME if resume else OpenMode.NEW)
    watch = Watch(lambda *_: None, lambda text: None)
    executors = ThisProcess() if workers is None else LocalProcesses()
    return run(settings, where, scene_meshes(settings, where), output, executors, watch, Stop())


def open_dataset(path: str | Path) -> Iterator[StoredEpisode]:
    """The episodes of a dataset one by one; each has `record`, `frames()` and `image(camera, number)`."""
    from .core.dataset.layout import episode_directories
    from .core.dataset.reader import open_episode

    for _, directory in episode_directories(Path(path)):
        yield open_episode(directory)


def evaluate(policy: str, n: int = 50, *, seed: int = 0, workers: int = 1, config: str = "default") -> dict[str, Any]:
    """Evaluate a policy, as `yamsim eval --json` does; in processes of its own, so guard a script's main part.

    Args:
        policy: such as `my_policy.py:MyPolicy`, see README.

    Returns:
        What `--json` prints: stats, trials.
    """
    flags = job_flags(rig=None, task=None, n=n, workers=workers, seed=seed, grasp=None) | {"wrist": (("wrist",), True)}
    where = locations()
    if policy.partition(":")[0] in ("scripted", "hold_still", "replay"):
        skip_gl()
    else:
        where = use_gl(where, workers=True)
    settings = record_config(config, where, flags)

    from .core.jobs.evaluate import evaluate as run
    from .core.jobs.evaluate import summary
    from .core.jobs.trials import PolicyChoice

    choice = PolicyChoice(policy, Path.cwd())
    found = run(settings, where, scene_meshes(settings, where), choice, lambda done, total: None)
    return summary(found, settings, (0.05, 0.08))
