"""Films of trials, for `trials` and `eval`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.progress import Progress
    from yamsim_cli.core.trials import FilmedTrial, TrialFilms


def films_at(path: Path, settings: RecordConfig, *, overwrite: bool) -> TrialFilms:
    """The place for a job's films; a path that cannot be used is refused before any trial runs."""
    from yamsim_cli.core.trials import TrialFilms

    timing = settings.task.timing
    return TrialFilms(path, timing.tick * timing.ticks_per_frame, overwrite=overwrite)


def film(films: TrialFilms, make: Callable[[Progress], list[FilmedTrial]]) -> list[dict[str, Any]]:
    """What a report says of the films that `make` makes; shows their progress meanwhile."""
    with progress_bar("filming", "trials") as advance:
        shown = make(advance)
    if films.moved_aside:
        note(f"What was at {films.path} is now at {films.moved_aside}.")
    return [{"trial": film.trial, "path": str(film.path)} for film in shown]
