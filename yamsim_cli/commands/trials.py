from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.output_files import ReportFile, VideoTrials, require_unused_reports, write_json_report
from yamsim_cli.flags.session_options import session_opener, session_settings
from yamsim_cli.terminal.console import print_note, print_report, progress_bar
from yamsim_cli.terminal.trial_tables import film_with_progress, open_films, trials_table

# `yamsim pickplace batch` is an alias of `yamsim trials`.
pickplace = typer.Typer(help="Run pick-and-place trials.", no_args_is_help=True)


@pickplace.callback()
def _pickplace() -> None:
    """Run pick-and-place trials."""


@pickplace.command(
    "batch",
    help="Run trials of the task pickplace without rendering, and count the successes: `yamsim trials` by another "
    "name.\n\nExample: yamsim pickplace batch --n 200 --seed 2 --json",
)
def trials(
    n: Annotated[int, typer.Option("--n", help="Trials.")] = 100,
    seed: flags.Seed = None,
    threshold: flags.Threshold = None,
    grasp: flags.Grasp = None,
    arm: flags.Arm = None,
    workers: flags.Workers = None,
    min_success: flags.MinSuccess = None,
    out: ReportFile = None,
    html: Annotated[Path | None, typer.Option(help="Also write a page with plots.")] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            help="Record videos of trials, failures first: one FILE.mp4 of all, or a file for each in a folder.",
            metavar="PATH",
        ),
    ] = None,
    video_trials: VideoTrials = 10,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Rename older videos, and replace reports.")] = False,
    task: flags.Task = None,
    item: flags.Object = None,
    target: flags.Target = None,
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    robot: flags.Robot = None,
    disturb: flags.Disturb = False,
    config: flags.ConfigOption = "default",
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Run trials of a task's expert from sampled starts without rendering, and count the successes.

    Example: yamsim trials --task tower --n 200 --seed 2 --json
    """
    require_unused_reports(out, html, overwrite=overwrite)
    session = session_opener.open(config, renders=video is not None, **session_settings(locals()))

    from yamsim_cli.core.statistics import THRESHOLDS
    from yamsim_cli.trials import film_trials, require_success, run_expert_trials

    films = open_films(video, session.config, overwrite=overwrite) if video else None
    with progress_bar("trials", "trials") as advance:
        report = run_expert_trials(session, THRESHOLDS, advance)
    if films:
        report["videos"] = film_with_progress(
            films, lambda shown: film_trials(report["trials"], video_trials, films, session, shown)
        )
    write_json_report(report, out)
    if html:
        from yamsim_cli.datasets.summarize import write_trials_page

        write_trials_page(report, session.config, html)
        report["html"] = str(html)
        print_note(f"The page is in {html}.")
    print_report(report, lambda: trials_table(report), json)
    require_success(report, min_success)
