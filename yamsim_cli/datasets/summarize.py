"""Check a dataset with worker processes, and write report pages."""

from __future__ import annotations

import contextlib
import functools
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.closable import Closable
from ..core.config.recording import RecordConfig
from ..core.dataset.checks.context import CheckContext, EpisodeDirectory, find_episodes, read_context
from ..core.dataset.checks.problem import ProblemCollector
from ..core.errors import InterruptedJobError
from ..core.files.resources import Locations
from ..core.images.jpeg import JpegReader, thumbnail
from ..core.markup import page_footer, write_page
from ..core.progress import Progress
from ..core.workers.executors import LostJobError, run_all
from ..core.workers.process_pool import ProcessPool
from .check_summary import CheckResults, combine_checks
from .checks.episode import check_episode
from .checks.episode_facts import EpisodeFacts
from .dataset_page import FrameStrip, dataset_page
from .leaderboard_page import leaderboard_page
from .trials_page import start_boxes, trials_page

_MAX_STRIPS = 6  # episodes with images on a report page
_THUMBNAIL_PX = 240  # px, longer side of these images


class EpisodeChecker(Closable):
    """Checks episodes in a separate process, because the JPEG decoder writes warnings to its stderr."""

    def __init__(self, context: CheckContext) -> None:
        self._context = context
        self._stack = contextlib.ExitStack()
        self._reader = self._stack.enter_context(JpegReader())

    def run(self, job: EpisodeDirectory) -> EpisodeFacts:
        """Check one episode."""
        return check_episode(job, self._context, self._reader)

    def close(self) -> None:
        """Close the JPEG decoder."""
        self._stack.close()


def check_dataset(dataset: Path, locations: Locations, workers: int, progress: Progress) -> CheckResults:
    """Check a dataset, with `workers` processes. No file is changed."""
    directories, recorded = find_episodes(dataset)
    problems = ProblemCollector()
    context = read_context(dataset, recorded, locations, problems)
    found: dict[EpisodeDirectory, EpisodeFacts] = {}
    try:
        if directories:
            factory = functools.partial(EpisodeChecker, context)
            with ProcessPool[EpisodeDirectory, EpisodeFacts](factory, min(workers, len(directories))) as pool:
                for directory, facts in run_all(pool, directories, _facts_of_crash):
                    found[directory] = facts
                    progress(len(found), len(directories))
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(found)} of {len(directories)} episodes; nothing was changed"
        ) from None
    return combine_checks(dataset, context, [found[directory] for directory in directories], problems)


def _facts_of_crash(error: LostJobError) -> EpisodeFacts:
    directory = error.job
    assert isinstance(directory, EpisodeDirectory)
    problems = ProblemCollector(directory.path.name)
    problems.add("episode.unchecked", value=f"{error.tries} processes that read it ended, the last one {error.reason}")
    return EpisodeFacts(directory.path.name, directory.number, problems=problems.all_problems())


def write_report(results: CheckResults, summary: Mapping[str, Any], path: Path) -> None:
    """Write the report page of a dataset atomically."""
    write_page(dataset_page(results, summary, contact_sheet(results), page_footer()), path)


def write_trials_page(report: Mapping[str, Any], config: RecordConfig, path: Path) -> None:
    """Write the report page of a batch of trials."""
    write_page(trials_page(report, start_boxes(config), page_footer()), path)


def write_leaderboard(reports: Sequence[Mapping[str, Any]], pairs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the page that ranks policies."""
    write_page(leaderboard_page(reports, pairs, page_footer()), path)


def contact_sheet(results: CheckResults) -> list[FrameStrip]:
    """Return images of up to `_MAX_STRIPS` episodes, first of those that ended farthest from the target."""
    shown = sorted(
        (episode for episode in results.episodes if any(episode.images.values())), key=_error_rank, reverse=True
    )
    return [strip for episode in shown[:_MAX_STRIPS] if (strip := _frame_strip(results.path, episode)).pictures]


def _error_rank(episode: EpisodeFacts) -> tuple[int, float]:
    distance = episode.outcome.dxy_m if episode.outcome else None
    return (0, 0.0) if distance is None else (1, distance)


def _frame_strip(dataset: Path, episode: EpisodeFacts) -> FrameStrip:
    # A fixed camera shows more than a wrist camera.
    _, names = min((("wrist" in camera, camera), names) for camera, names in episode.images.items() if names)
    chosen = [names[k] for k in dict.fromkeys((0, (len(names) - 1) // 2, len(names) - 1))]
    pictures = [picture for name in chosen if (picture := _make_thumbnail(dataset / episode.name / name))]
    distance = episode.outcome.dxy_m if episode.outcome else None
    caption = "" if distance is None else f"ended {distance * 1000:.1f} mm off"
    return FrameStrip(episode.name, caption, pictures)


def _make_thumbnail(path: Path) -> bytes | None:
    try:
        return thumbnail(path.read_bytes(), _THUMBNAIL_PX) if stat.S_ISREG(path.stat().st_mode) else None
    except OSError:
        return None
