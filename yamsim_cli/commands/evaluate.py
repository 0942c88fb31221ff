"""`yamsim eval`: how often a policy succeeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.core.errors import UsageError

from .console import note, print_json, print_table, progress_bar
from .films import film, films_at
from .session import Json, Revision, opener
from .settings import (
    Arm,
    ConfigOption,
    Grasp,
    MinSuccess,
    Object,
    Quality,
    Randomize,
    ReportFile,
    Rig,
    Seed,
    Size,
    Target,
    Task,
    Threshold,
    Workers,
)
from .trials import evaluation_table


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
    threshold: Threshold = None,
    time_limit: Annotated[
        float | None, typer.Option(min=0.001, help="Longest trial, simulated s.  [default: twice the plan's]")
    ] = None,
    policy_timeout: Annotated[
        float, typer.Option(min=0.001, help="Real seconds that one answer of the policy may take.")
    ] = 30.0,
    trial_timeout: Annotated[
        float, typer.Option(min=1, help="Real seconds after which a trial's worker counts as hung.")
    ] = 600.0,
    min_success: MinSuccess = None,
    out: ReportFile = None,
    video: Annotated[
        Path | None, typer.Option(help="Film failures: all in one FILE.mp4, or one each in a folder.", metavar="PATH")
    ] = None,
    video_trials: Annotated[int, typer.Option(min=1, metavar="N", help="With --video: how many at most.")] = 10,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Move older videos aside.")] = False,
    grasp: Grasp = None,
    randomize: Randomize = None,
    size: Size = None,
    quality: Quality = None,
    task: Task = None,
    item: Object = None,
    target: Target = None,
    rig: Rig = None,
    revision: Revision = None,
    arm: Arm = None,
    config: ConfigOption = "default",
    json: Json = False,
) -> None:
    """Run a policy from sampled starts, the same as `pickplace batch` has for that seed, and count its successes.

    Exit code 6 if the policy failed in every trial before its end, so that nothing was measured.

    Example: yamsim eval --policy my_policy.py:MyPolicy --n 50 --seed 0 --workers 2
    """
    if overwrite and video is None:
        raise UsageError("--overwrite is for videos: give --video")
    from yamsim_cli.core.policies.loading import sees_images

    session = opener.open(
        config,
        renders=video is not None or sees_images(policy),
        n=n,
        seed=seed,
        workers=workers,
        threshold=threshold,
        grasp=grasp,
        randomize=randomize,
        size=size,
        quality=quality,
        task=task,
        object=item,
        target=target,
        rig=rig,
        revision=revision,
        arm=arm,
        wrist=True,
    )

    from yamsim_cli.core.dataset.statistics import THRESHOLDS
    from yamsim_cli.core.evaluate import evaluation
    from yamsim_cli.core.evaluate.policy_trial import PolicyChoice
    from yamsim_cli.core.trials.batch import write_report
    from yamsim_cli.core.trials.tally import require_success

    films = films_at(video, session.config, overwrite=overwrite) if video else None
    choice = PolicyChoice(policy, Path.cwd(), policy_timeout, time_limit)
    with progress_bar("trials", "trials") as advance:
        found = evaluation.evaluate(
            session,
            choice,
            lambda done, total: advance(done, total, ""),
            trial_timeout,
        )
    report = evaluation.summary(found, session.config, THRESHOLDS)
    if films:
        report["videos"] = film(
            films,
            lambda told: evaluation.film(found, video_trials, films, session, told),
        )
    if out is not None:
        write_report(report, out)
        note(f"Written to {out}.")
    if json:
        print_json(report)
    else:
        print_table(evaluation_table(report))
    evaluation.require_run(report)
    require_success(report["stats"], min_success)
