"""`yamsim trials`: run a task many times without recording, and count."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.flags.outputs import require_free
from yamsim_cli.flags.session import Json, Offline, Revision, Robot, opener
from yamsim_cli.flags.settings import (
    Arm,
    ConfigOption,
    Grasp,
    MinSuccess,
    Object,
    ReportFile,
    Rig,
    Seed,
    Target,
    Task,
    Threshold,
    Workers,
)
from yamsim_cli.terminal.console import note, print_json, print_table, progress_bar
from yamsim_cli.terminal.films import film, films_at
from yamsim_cli.terminal.trial_tables import trials_table


def trials(
    n: Annotated[int, typer.Option("--n", help="Trials.")] = 100,
    seed: Seed = None,
    threshold: Threshold = None,
    grasp: Grasp = None,
    arm: Arm = None,
    workers: Workers = None,
    min_success: MinSuccess = None,
    out: ReportFile = None,
    html: Annotated[Path | None, typer.Option(help="Also write a page with plots, over the sampling box too.")] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film trials: all in one FILE.mp4, or one each in a folder.", metavar="PATH")
    ] = None,
    video_trials: Annotated[
        int, typer.Option(min=1, metavar="N", help="With --video: how many at most, failures first.")
    ] = 10,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Move older videos aside, and replace reports that exist.")
    ] = False,
    task: Task = None,
    item: Object = None,
    target: Target = None,
    rig: Rig = None,
    revision: Revision = None,
    robot: Robot = None,
    config: ConfigOption = "default",
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Run trials of a task's expert from sampled starts without rendering, and count the successes.

    Example: yamsim trials --task tower --n 200 --seed 2 --json
    """
    for flag, file in (("--out", out), ("--html", html)):
        if file is not None:
            require_free(flag, file, overwrite=overwrite)
    session = opener.open(
        config,
        renders=video is not None,
        n=n,
        seed=seed,
        threshold=threshold,
        grasp=grasp,
        arm=arm,
        workers=workers,
        task=task,
        object=item,
        target=target,
        rig=rig,
        revision=revision,
        robot=robot,
    )

    from yamsim_cli.core.dataset.statistics import THRESHOLDS
    from yamsim_cli.core.documents.json_text import json_text
    from yamsim_cli.core.files import write_output
    from yamsim_cli.core.trials import film_trials, require_success, run_batch

    films = films_at(video, session.config, overwrite=overwrite) if video else None
    with progress_bar("trials", "trials") as advance:
        report = run_batch(session, THRESHOLDS, advance)
    if films:
        report["videos"] = film(films, lambda told: film_trials(report["trials"], video_trials, films, session, told))
    if out is not None:
        write_output(out, json_text(report).encode())
        note(f"Written to {out}.")
    if html:
        from yamsim_cli.core.summarize import write_trials_page

        write_trials_page(report, session.config, html)
        report["html"] = str(html)
        note(f"The page is in {html}.")
    if json:
        print_json(report)
    else:
        print_table(trials_table(report))
    require_success(report, min_success)
