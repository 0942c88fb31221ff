"""`yamsim pickplace`: run the pick-and-place task without recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError

from .console import note, print_json, print_table, progress_bar
from .pages import require_free
from .session import (
    Arm,
    ConfigOption,
    Grasp,
    Json,
    Object,
    Rig,
    Seed,
    Target,
    Task,
    Workers,
    job_flags,
    locations,
    record_config,
    scene_meshes,
    skip_gl,
    use_gl,
)
from .trials import trials_table

if TYPE_CHECKING:
    from yamsim_cli.core.config.record import RecordConfig
    from yamsim_cli.core.jobs.films import TrialFilms
    from yamsim_cli.core.resources import Locations

app = typer.Typer(help="Run pick-and-place trials.", no_args_is_help=True)

# Scored beside the threshold asked for. Source: the lab reports both.
_THRESHOLDS = (0.05, 0.08)


@app.callback()
def _pickplace() -> None:
    """Run pick-and-place trials."""


@app.command()
def batch(
    n: Annotated[int, typer.Option("--n", help="Trials.")] = 100,
    seed: Seed = None,
    threshold: Annotated[
        float | None, typer.Option(help="Largest distance from the target's centre, m.  [default: the task's, 0.05]")
    ] = None,
    grasp: Grasp = None,
    arm: Arm = None,
    workers: Workers = None,
    out: Annotated[Path | None, typer.Option(help="Also write the JSON to this file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Also write a page with plots, over the sampling box too.")] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film trials: all in one FILE.mp4, or one each in a folder.", metavar="PATH")
    ] = None,
    video_trials: Annotated[
        int, typer.Option(min=1, metavar="N", help="With --video: how many at most, failures first.")
    ] = 10,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Move older videos aside, and replace an older page.")
    ] = False,
    task: Task = None,
    item: Object = None,
    target: Target = None,
    rig: Rig = None,
    config: ConfigOption = "default",
    json: Json = False,
) -> None:
    """Run randomized trials in physics alone and count the successes; --video draws some of them.

    Example: yamsim pickplace batch --n 200 --seed 2 --json
    """
    if overwrite and video is None and html is None:
        raise UsageError("--overwrite is for videos and pages: give --video or --html")
    if html:
        require_free(html, overwrite)
    where = locations()
    flags = job_flags(
        rig=rig, task=task, item=item, target=target, n=n, workers=workers, seed=seed, grasp=grasp, arm=arm
    ) | {"--threshold": (("task", "success", "threshold"), threshold)}
    settings = record_config(config, where, flags)
    if video is None:
        skip_gl()
    else:
        settings = record_config(config, use_gl(where, workers=True), flags)

    from yamsim_cli.core.jobs.batch import run_batch, write_report
    from yamsim_cli.core.jobs.films import TrialFilms

    timing = settings.task.timing
    films = video and TrialFilms(video, timing.tick * timing.ticks_per_frame, overwrite=overwrite)

    with progress_bar("trials", "trials") as advance:
        report = run_batch(settings, where, _THRESHOLDS, lambda done, wanted: advance(done, wanted, ""))
    if films:
        report["videos"] = _film(report, video_trials, films, settings, where)
    if out is not None:
        write_report(report, out)
        note(f"Written to {out}.")
    if html:
        from yamsim_cli.core.jobs.report import write_trials_page

        write_trials_page(report, settings.sampled, html)
        report["html"] = str(html)
        note(f"The page is in {html}.")
    if json:
        print_json(report)
    else:
        print_table(trials_table(report))


def _film(
    report: dict[str, Any], limit: int, films: TrialFilms, settings: RecordConfig, where: Locations
) -> list[dict[str, Any]]:
    from yamsim_cli.core.jobs.films import film_trials

    meshes = scene_meshes(settings, where)
    with progress_bar("filming", "trials") as advance:
        shown = film_trials(
            report["trials"], limit, films, settings, where, meshes, lambda done, wanted: advance(done, wanted, "")
        )
    if films.moved_aside:
        note(f"What was at {films.path} is now at {films.moved_aside}.")
    return [{"trial": film.trial, "path": str(film.path)} for film in shown]
