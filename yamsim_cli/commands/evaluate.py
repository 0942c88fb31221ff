"""`yamsim eval`: how often a policy succeeds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError

from .console import note, print_json, print_table, progress_bar
from .evaluation_table import evaluation_table
from .session import (
    ConfigOption,
    Json,
    Quality,
    Rig,
    Seed,
    Task,
    Workers,
    job_flags,
    locations,
    parse_size,
    randomization,
    record_config,
    scene_meshes,
    skip_gl,
    use_gl,
)

if TYPE_CHECKING:
    from yamsim_cli.core.config.record import RecordConfig
    from yamsim_cli.core.jobs.evaluate import Evaluation
    from yamsim_cli.core.jobs.films import TrialFilms
    from yamsim_cli.core.resources import Locations

# Policies that see no images: nothing is drawn for them.
_BLIND = ("scripted", "hold_still", "replay")

# Scored beside the threshold asked for. Source: the lab reports both.
_THRESHOLDS = (0.05, 0.08)


def evaluate(
    policy: Annotated[
        str,
        typer.Option(
            help="module:Class, file.py:Class, http://HOST:PORT, scripted, hold_still, or replay:DATASET.",
            show_default=False,
        ),
    ],
    n: Annotated[int, typer.Option("--n", min=1, help="Trials.")] = 50,
    seed: Seed = None,
    workers: Workers = None,
    threshold: Annotated[
        float | None, typer.Option(help="Largest distance from the target's centre, m.  [default: the task's, 0.05]")
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option(min=0.001, help="Of a trial, in simulated s.  [default: twice the plan's]")
    ] = None,
    policy_timeout: Annotated[float, typer.Option(min=0.001, help="For one answer of the policy, in real s.")] = 30.0,
    trial_timeout: Annotated[
        float, typer.Option(min=1, help="Real seconds after which a trial's worker counts as hung.")
    ] = 600.0,
    out: Annotated[Path | None, typer.Option(help="Also write the JSON to this file.")] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film failures: all in one FILE.mp4, or one each in a folder.", metavar="PATH")
    ] = None,
    video_trials: Annotated[int, typer.Option(min=1, metavar="N", help="With --video: how many at most.")] = 10,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Move older videos aside.")] = False,
    grasp: Annotated[str | None, typer.Option(help="How the object is held: weld.")] = None,
    randomize: Annotated[
        bool | None, typer.Option("--randomize/--no-randomize", help="Vary lights, camera, looks, weights, and more.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of what the policy sees, in pixels.")] = None,
    quality: Quality = None,
    task: Task = None,
    rig: Rig = None,
    config: ConfigOption = "default",
    json: Json = False,
) -> None:
    """Run a policy on randomized trials, the same that `pickplace batch` has for a seed, and count its successes.

    Example: yamsim eval --policy my_policy.py:MyPolicy --n 50 --seed 0 --workers 2
    """
    if overwrite and video is None:
        raise UsageError("--overwrite is for videos: give --video")
    where = locations()
    flags = job_flags(rig=rig, task=task, n=n, workers=workers, seed=seed, grasp=grasp) | {
        "--threshold": (("task", "success", "threshold"), threshold),
        "--size": (("image", "size_px"), parse_size(size) if size else None),
        "--quality": (("render",), quality),
        "wrist": (("wrist",), True),
    }
    checked = record_config(config, where, flags)
    flags["--randomize"] = (("randomization",), randomization(randomize, checked))
    if video is None and policy.partition(":")[0] in _BLIND:
        skip_gl()
    else:
        where = use_gl(where, workers=True)
    settings = record_config(config, where, flags)

    from yamsim_cli.core.jobs.batch import write_report
    from yamsim_cli.core.jobs.evaluate import evaluate as run
    from yamsim_cli.core.jobs.evaluate import summary
    from yamsim_cli.core.jobs.films import TrialFilms
    from yamsim_cli.core.jobs.trials import PolicyChoice

    timing = settings.task.timing
    films = video and TrialFilms(video, timing.tick * timing.ticks_per_frame, overwrite=overwrite)
    choice = PolicyChoice(policy, Path.cwd(), policy_timeout, time_limit)
    meshes = scene_meshes(settings, where)
    with progress_bar("trials", "trials") as advance:
        found = run(settings, where, meshes, choice, lambda done, total: advance(done, total, ""), trial_timeout)
    report = summary(found, settings, _THRESHOLDS)
    if films:
        report["videos"] = _film(found, video_trials, films, settings, where)
    if out is not None:
        write_report(report, out)
        note(f"Written to {out}.")
    if json:
        print_json(report)
    else:
        print_table(evaluation_table(report))


def _film(
    found: Evaluation, limit: int, films: TrialFilms, settings: RecordConfig, where: Locations
) -> list[dict[str, Any]]:
    from yamsim_cli.core.jobs.evaluate import film

    meshes = scene_meshes(settings, where)
    with progress_bar("filming", "trials") as advance:
        shown = film(found, limit, films, settings, where, meshes, lambda done, total: advance(done, total, ""))
    if films.moved_aside:
        note(f"What was at {films.path} is now at {films.moved_aside}.")
    return [{"trial": film.trial, "path": str(film.path)} for film in shown]
