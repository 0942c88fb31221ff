"""Surveys a dataset: workers open its files, and this process puts together what they find."""

from __future__ import annotations

import functools
from pathlib import Path
from types import TracebackType

from ..dataset.checks.context import Context, EpisodeDirectory, find_episodes, read_context
from ..dataset.checks.episode import check_episode
from ..dataset.checks.facts import EpisodeFacts
from ..dataset.checks.problem import Problems
from ..dataset.survey import Survey, survey
from ..errors import InterruptedJobError
from ..images.jpeg import JpegReader
from ..progress import Progress
from ..resources import Locations
from ..workers.executor import LostJobError
from ..workers.processes import WorkerPool


class EpisodeChecker:
    """Checks episodes, in a worker's own process, since the decoder of JPEGs complains on its process's stderr."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._reader = JpegReader()

    def run(self, job: EpisodeDirectory) -> EpisodeFacts:
        """What is found in an episode."""
        return check_episode(job, self._context, self._reader)

    def __enter__(self) -> EpisodeChecker:
        self._reader.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.__exit__(kind, error, trace)


def survey_dataset(dataset: Path, locations: Locations, workers: int, progress: Progress) -> Survey:
    """All that is found in a dataset. Every file is opened, and nothing is changed.

    Args:
        workers: number of processes.

    Raises:
        DatasetError: there is no dataset.
        InterruptedJobError: stopped by the user.
        PartialJobError: no worker can be kept alive.
    """
    directories, recorded = find_episodes(dataset)
    problems = Problems()
    context = read_context(dataset, recorded, locations, problems)
    found: dict[EpisodeDirectory, EpisodeFacts] = {}
    try:
        if directories:
            factory = functools.partial(EpisodeChecker, context)
            with WorkerPool[EpisodeDirectory, EpisodeFacts](factory, min(workers, len(directories))) as pool:
                waiting = iter(directories)
                while len(found) < len(directories):
                    while pool.idle and (job := next(waiting, None)):
                        pool.submit(job)
                    try:
                        done, facts = pool.result()
                    except LostJobError as error:
                        done, facts = _unchecked(error)
                    found[done] = facts
                    progress(len(found), len(directories))
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(found)} of {len(directories)} episodes; nothing was changed"
        ) from None
    return survey(dataset, context, [found[directory] for directory in directories], problems)


def _unchecked(error: LostJobError) -> tuple[EpisodeDirectory, EpisodeFacts]:
    """An episode that ends every process that opens it, and the fault that says so."""
    directory = error.job
    assert isinstance(directory, EpisodeDirectory)
    problems = Problems(directory.path.name)
    problems.add("episode.unchecked", value=f"{error.tries} processes were ended by it, the last one {error.reason}")
    return directory, EpisodeFacts(directory.path.name, directory.number, problems=problems.list())
