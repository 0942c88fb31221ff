"""Films of trials, as a batch and an evaluation make them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.trials.films import FilmedTrial, Progress, TrialFilms


def films_at(path: Path, settings: RecordConfig, *, overwrite: bool) -> TrialFilms:
    """Where a job's films go; what is wrong with it is told before any trial runs."""
    from yamsim_cli.core.trials.films import TrialFilms

    timing = settings.task.timing
    return TrialFilms(path, timing.tick * timing.ticks_per_frame, overwrite=overwrite)


def film(films: TrialFilms, make: Callable[[Progress], list[FilmedTrial]]) -> list[dict[str, Any]]:
    """Make films and tell how far they are, as what a report says of them."""
    with progress_bar("filming", "trials") as advance:
        shown = make(lambda done, wanted: advance(done, wanted, ""))
    if films.moved_aside:
        note(f"What was at {films.path} is now at {films.moved_aside}.")
    return [{"trial": film.trial, "path": str(film.path)} for film in shown]
