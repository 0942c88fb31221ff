"""Summarize a dataset: worker processes check its episodes, and this process writes the pages on what they find."""

from __future__ import annotations

import contextlib
import functools
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.closing import Closing
from ..core.config.recording import RecordConfig
from ..core.dataset.checks.context import Context, EpisodeDirectory, find_episodes, read_context
from ..core.dataset.checks.problem import Problems
from ..core.errors import InterruptedJobError
from ..core.files.resources import Locations
from ..core.images.jpeg import JpegReader, thumbnail
from ..core.markup import made_line, write_page
from ..core.progress import Progress
from ..core.workers.executor import LostJobError, run_all
from ..core.workers.processes import WorkerPool
from .checks.episode import check_episode
from .checks.facts import EpisodeFacts
from .dataset_page import Strip, dataset_page
from .leaderboard_page import leaderboard_page
from .summary import Survey, survey
from .trials_page import start_boxes, trials_page

_STRIPS = 6  # episodes of which a page shows pictures
_THUMBNAIL_PX = 240  # longer side of these pictures


class EpisodeChecker(Closing):
    """Checks episodes, in a worker's own process: the JPEG decoder writes complaints to its process's stderr."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._stack = contextlib.ExitStack()
        self._reader = self._stack.enter_context(JpegReader())

    def run(self, job: EpisodeDirectory) -> EpisodeFacts:
        """Check one episode."""
        return check_episode(job, self._context, self._reader)

    def close(self) -> None:
        """Close the JPEG decoder."""
        self._stack.close()


def survey_dataset(dataset: Path, locations: Locations, workers: int, progress: Progress) -> Survey:
    """Check a dataset with worker processes. Every file is opened, and nothing is changed.

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
                for directory, facts in run_all(pool, directories, _unchecked):
                    found[directory] = facts
                    progress(len(found), len(directories))
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(found)} of {len(directories)} episodes; nothing was changed"
        ) from None
    return survey(dataset, context, [found[directory] for directory in directories], problems)


def _unchecked(error: LostJobError) -> EpisodeFacts:
    """The facts of an episode that ends every process that opens it: this fault alone."""
    directory = error.job
    assert isinstance(directory, EpisodeDirectory)
    problems = Problems(directory.path.name)
    problems.add("episode.unchecked", value=f"{error.tries} processes were ended by it, the last one {error.reason}")
    return EpisodeFacts(directory.path.name, directory.number, problems=problems.list())


def write_report(survey: Survey, summary: Mapping[str, Any], path: Path) -> None:
    """Write a dataset's page, whole or not at all; raises ResourceError if the file cannot be written."""
    write_page(dataset_page(survey, summary, contact_sheet(survey), made_line()), path)


def write_trials_page(report: Mapping[str, Any], config: RecordConfig, path: Path) -> None:
    """Write the page of a batch of trials of `config`; raises as `write_report`."""
    write_page(trials_page(report, start_boxes(config), made_line()), path)


def write_leaderboard(reports: Sequence[Mapping[str, Any]], pairs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a leaderboard's page; raises as `write_report`."""
    write_page(leaderboard_page(reports, pairs, made_line()), path)


def contact_sheet(survey: Survey) -> list[Strip]:
    """First, middle and last picture of `_STRIPS` episodes, those that ended farthest from the target first."""
    shown = sorted((episode for episode in survey.episodes if any(episode.images.values())), key=_badness, reverse=True)
    return [strip for episode in shown[:_STRIPS] if (strip := _strip(survey.path, episode)).pictures]


def _badness(episode: EpisodeFacts) -> tuple[int, float]:
    distance = episode.outcome.dxy_m if episode.outcome else None
    return (0, 0.0) if distance is None else (1, distance)


def _strip(dataset: Path, episode: EpisodeFacts) -> Strip:
    # A fixed camera shows more of the episode than a wrist camera.
    _, names = min((("wrist" in camera, camera), names) for camera, names in episode.images.items() if names)
    chosen = [names[k] for k in dict.fromkeys((0, (len(names) - 1) // 2, len(names) - 1))]
    pictures = [picture for name in chosen if (picture := _picture(dataset / episode.name / name))]
    distance = episode.outcome.dxy_m if episode.outcome else None
    caption = "" if distance is None else f"ended {distance * 1000:.1f} mm off"
    return Strip(episode.name, caption, pictures)


def _picture(path: Path) -> bytes | None:
    """A thumbnail; None if the file has changed since the checks, and is no picture any more."""
    try:
        return thumbnail(path.read_bytes(), _THUMBNAIL_PX) if stat.S_ISREG(path.stat().st_mode) else None
    except OSError:
        return None
