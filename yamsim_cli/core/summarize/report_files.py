"""Writes the pages of datasets and of batches; a page is written whole or not at all."""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..config.recording import RecordConfig
from ..dataset.checks.facts import EpisodeFacts
from ..dataset.survey import Survey
from ..images.jpeg import thumbnail
from ..report.dataset_page import Strip, dataset_page
from ..report.leaderboard_page import leaderboard_page
from ..report.markup import made_line, write_page
from ..report.trials_page import start_boxes, trials_page

_STRIPS = 6
_THUMBNAIL_PX = 240


def write_report(survey: Survey, summary: Mapping[str, Any], path: Path) -> None:
    """Write a dataset's page, replacing what is there.

    Raises:
        ResourceError: the file cannot be written.
    """
    write_page(dataset_page(survey, summary, contact_sheet(survey), made_line()), path)


def write_trials_page(report: Mapping[str, Any], config: RecordConfig, path: Path) -> None:
    """Write a batch's page, replacing what is there. Raises as `write_report`.

    Args:
        config: by which the trials were run.
    """
    write_page(trials_page(report, start_boxes(config), made_line()), path)


def write_leaderboard(reports: Sequence[Mapping[str, Any]], pairs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a leaderboard's page, replacing what is there. Raises as `write_report`."""
    write_page(leaderboard_page(reports, pairs, made_line()), path)


def contact_sheet(survey: Survey) -> list[Strip]:
    """First, middle and last picture of a handful of episodes, those that ended farthest from the target first."""
    shown = sorted((episode for episode in survey.episodes if any(episode.images.values())), key=_badness, reverse=True)
    return [strip for episode in shown[:_STRIPS] if (strip := _strip(survey.path, episode)).pictures]


def _badness(episode: EpisodeFacts) -> tuple[int, float]:
    distance = episode.outcome.dxy_m if episode.outcome else None
    return (0, 0.0) if distance is None else (1, distance)


def _strip(dataset: Path, episode: EpisodeFacts) -> Strip:
    # A fixed camera shows more of what happened than one at the wrist.
    _, names = min((("wrist" in camera, camera), names) for camera, names in episode.images.items() if names)
    chosen = [names[k] for k in dict.fromkeys((0, (len(names) - 1) // 2, len(names) - 1))]
    pictures = [picture for name in chosen if (picture := _picture(dataset / episode.name / name))]
    distance = episode.outcome.dxy_m if episode.outcome else None
    caption = "" if distance is None else f"ended {distance * 1000:.1f} mm off"
    return Strip(episode.name, caption, pictures)


def _picture(path: Path) -> bytes | None:
    """A thumbnail; None if the file has changed since it was checked, and is no picture any more."""
    try:
        return thumbnail(path.read_bytes(), _THUMBNAIL_PX) if stat.S_ISREG(path.stat().st_mode) else None
    except OSError:
        return None
