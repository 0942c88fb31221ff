"""Images of many episodes, rendered in this process or in a pool of processes."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

from .core.attempt_data import Attempt
from .core.closable import Closable
from .core.config.session import Session
from .core.episode.attempt_payload import render_cameras
from .core.episode.runner import SessionRunner
from .core.geometry.se3 import Array
from .core.images.image import Image
from .core.workers.executors import run_all
from .core.workers.process_pool import ProcessPool
from .policies.evaluate.stepped_task import RunningTrial


@dataclass(frozen=True)
class _PictureJob:
    """Positions of MuJoCo (nq,) in an attempt that are to be rendered from cameras; `row` numbers the jobs."""

    row: int
    attempt: Attempt
    qpos: Array
    cameras: tuple[str, ...]


class _PictureRenderer(SessionRunner):
    """Renders the jobs of a process."""

    def run(self, job: _PictureJob) -> dict[str, Image]:
        """Return camera -> image."""
        simulator = self._simulators.get(job.attempt.job)
        return render_cameras(simulator, job.attempt, job.qpos, job.cameras)


class Pictures(Closable):
    """Renders the present states of trials.

    Args:
        processes: that render; 1 renders in this process.
    """

    def __init__(self, session: Session, processes: int) -> None:
        self._session, self._processes = session, processes
        self._pool: ProcessPool[_PictureJob, dict[str, Image]] | None = None

    def render(self, trials: Sequence[RunningTrial], cameras: tuple[str, ...]) -> list[dict[str, Image]]:
        """Return camera -> image (height, width, 3), for each trial."""
        if self._processes == 1:
            return [trial.render(cameras) for trial in trials]
        if self._pool is None:
            factory = functools.partial(_PictureRenderer, self._session)
            self._pool = ProcessPool(factory, self._processes)
        jobs = [_PictureJob(k, one.attempt, one.episode.data.qpos.copy(), cameras) for k, one in enumerate(trials)]
        found = {job.row: images for job, images in run_all(self._pool, jobs)}
        return [found[k] for k in range(len(trials))]

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.close()
            self._pool = None
