"""Films of trials: made again from their numbers and rendered, which a batch itself does not do."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..attempt.engine import Simulated, demonstrate
from ..attempt.pictures import render
from ..attempt.sampling import sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..closing import Closing
from ..config.recording import SCENE_CAMERA
from ..errors import InterruptedJobError, ResourceError, SimulationError, UsageError
from ..files import move_aside
from ..images.jpeg import decode_jpeg, encode_jpeg
from ..images.video import VideoWriter, require_encoder
from ..progress import Progress
from ..session import Session
from ..types import Cause, EpisodeJob
from ..vision.views import label
from ..workers.executor import Executor, Factory, J
from ..workers.processes import WorkerPool

# Trials that end before anything moves.
_NEVER_MOVED = (Cause.NO_LAYOUT, Cause.UNREACHABLE)

# On the way from a worker to the film: hardly any loss beside that of the film itself.
_JPEG_QUALITY = 95


@dataclass(frozen=True)
class FilmedTrial:
    """A trial and the video that shows it."""

    trial: int
    path: Path


class TrialFilmer(Closing):
    """Renders what happened in physics; a context manager, since it owns a renderer."""

    def __init__(self, session: Session) -> None:
        self._simulators = Simulators(session)

    def _film(self, simulator: Simulator, done: Simulated) -> list[bytes]:
        """Its frames as JPEGs; none of what never moved."""
        shown = (render(simulator, done.attempt, state.qpos, (SCENE_CAMERA,)) for state in done.states)
        return [encode_jpeg(images[SCENE_CAMERA], _JPEG_QUALITY) for images in shown]

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()


class PlannedFilmer(TrialFilmer):
    """Makes trials again as their plans have them, and renders them whatever their outcome."""

    def run(self, job: EpisodeJob) -> list[bytes]:
        """The trial's frames as JPEGs."""
        simulator = self._simulators.of(job)
        return self._film(simulator, demonstrate(simulator, sample(simulator, job)))


class TrialFilms:
    """Where films go: one file with all of them if its name ends in `.mp4`, else a folder with one each.

    What can be checked is checked at once, so that no trial runs in vain.

    Args:
        path: of the file or the folder.
        frame_period: of the trials, s.
        overwrite: move what is there aside.

    Raises:
        UsageError: something is in the way.
        ResourceError: videos cannot be written here.
    """

    def __init__(self, path: Path, frame_period: float, *, overwrite: bool) -> None:
        require_encoder()
        self.path = path
        self._period = frame_period
        self._overwrite = overwrite
        self._reel = VideoWriter(path, frame_period, overwrite=overwrite) if path.suffix.lower() == ".mp4" else None
        self.moved_aside: Path | None = None
        if not self._reel and path.exists() and not overwrite and (not path.is_dir() or any(path.iterdir())):
            raise UsageError(f"{path} is not empty; move it aside with --overwrite, or choose another --video")

    def write(self, trials: Iterator[tuple[dict[str, Any], list[bytes]]]) -> list[FilmedTrial]:
        """Write the frames of trials, in their order.

        Raises:
            ResourceError: the disk is full, or may not be written.
        """
        if self._reel:
            with self._reel as video:
                shown = [_add(video, trial, frames) for trial, frames in trials]
            self.moved_aside = self._reel.moved_aside
            return [FilmedTrial(number, self.path) for number in shown]
        self._make_folder()
        films = []
        for trial, frames in trials:
            path = self.path / f"trial_{trial['trial']:06d}_{_ending(trial)}.mp4"
            with VideoWriter(path, self._period) as video:
                films.append(FilmedTrial(_add(video, trial, frames), path))
        return films

    def _make_folder(self) -> None:
        try:
            if self._overwrite and self.path.exists():
                self.moved_aside = move_aside(self.path)
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResourceError(f"{self.path} cannot be made: {error.strerror}; choose another --video") from error


def _ending(trial: Mapping[str, Any]) -> str:
    return str(trial["outcome"]["cause"] or "success")


def _add(video: VideoWriter, trial: Mapping[str, Any], frames: Sequence[bytes]) -> int:
    number = int(trial["trial"])
    for data in frames:
        image = decode_jpeg(data)
        if image is None:
            raise SimulationError(f"a frame of trial {number} was damaged on its way from the worker")
        video.write(label(image, {}, f"trial {number}: {_ending(trial).replace('_', ' ')}"))
    return number


def film_trials(
    trials: Sequence[dict[str, Any]],
    limit: int,
    films: TrialFilms,
    session: Session,
    progress: Progress,
) -> list[FilmedTrial]:
    """Film trials of a batch, failures first; those in which nothing moved cannot be shown.

    Args:
        trials: as `run_batch` reports them.
        limit: of how many at most.

    Raises:
        InterruptedJobError: stopped by the user; finished films stay.
        ResourceError: nothing can render here, or the films cannot be written.
    """
    moving = [trial for trial in trials if trial["outcome"]["cause"] not in _NEVER_MOVED]
    chosen = sorted(moving, key=lambda trial: trial["outcome"]["success"])[:limit]
    if not chosen:
        return []
    factory = functools.partial(PlannedFilmer, session)
    jobs = [EpisodeJob(trial["seed"], trial["trial"]) for trial in chosen]
    return film_jobs(factory, chosen, jobs, films, session.config.workers, progress)


def film_jobs(
    factory: Factory[J, list[bytes]],
    trials: Sequence[dict[str, Any]],
    jobs: Sequence[J],
    films: TrialFilms,
    workers: int,
    progress: Progress,
) -> list[FilmedTrial]:
    """Film trials whose frames the jobs give, at least one of them. Raises as `film_trials`."""
    try:
        with WorkerPool[J, list[bytes]](factory, min(workers, len(jobs))) as pool:
            return films.write(frames_in_order(trials, jobs, pool, progress))
    except KeyboardInterrupt:
        raise InterruptedJobError(f"interrupted while filming into {films.path}; finished films are whole") from None


def frames_in_order(
    trials: Sequence[dict[str, Any]], jobs: Sequence[J], pool: Executor[J, list[bytes]], progress: Progress
) -> Iterator[tuple[dict[str, Any], list[bytes]]]:
    """Trials with the frames that their jobs give, in the order given, whichever is finished first."""
    waiting = list(reversed(range(len(jobs))))
    numbers = {id(job): number for number, job in enumerate(jobs)}
    finished: dict[int, list[bytes]] = {}
    for number, trial in enumerate(trials):
        while number not in finished:
            while pool.idle and waiting:
                pool.submit(jobs[waiting.pop()])
            job, frames = pool.result()
            finished[numbers[id(job)]] = frames
        yield trial, finished.pop(number)
        progress(number + 1, len(trials))
