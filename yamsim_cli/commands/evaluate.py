"""`yamsim eval`: how often a policy succeeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.outputs import require_free
from yamsim_cli.flags.session import Json, Offline, Revision, Robot, opener
from yamsim_cli.flags.settings import (
    Arm,
    ConfigOption,
    Grasp,
    MinSuccess,
    Object,
    Quality,
    Randomization,
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
from yamsim_cli.terminal.console import note, print_json, print_table, progress_bar
from yamsim_cli.terminal.films import film, films_at
from yamsim_cli.terminal.trial_tables import evaluation_table


def evaluate(
    policy: Annotated[
        str,
        typer.Option(
            help="module:Class, file.py:Class, act://HOST:PORT, ws://HOST:PORT, lerobot:CHECKPOINT, http://HOST:PORT, "
            "scripted, hold_still, or replay:DATASET.",
            show_default=False,
        ),
    ],
    n: Annotated[int, typer.Option("--n", min=1, help="Trials.")] = 50,
    seed: Seed = None,
    workers: Workers = None,
    policy_arg: Annotated[
        list[str] | None,
        typer.Option(
            help="A keyword for your own policy's class, and for compared classes that take it; may be repeated.",
            metavar="KEY=VALUE",
        ),
    ] = None,
    policy_config: Annotated[
        str | None,
        typer.Option(
            help="What policies of other programs call things: a config of the kind policies.  "
            "[default: by the policy's protocol]"
        ),
    ] = None,
    execute: Annotated[
        int | None,
        typer.Option(min=1, metavar="K", help="Ask again after so many actions of a chunk.  [default: all of it]"),
    ] = None,
    ensemble: Annotated[
        float | None,
        typer.Option(
            min=0, max=100, metavar="DECAY", help="Average chunks that overlap, newer ones by exp(-DECAY) less each."
        ),
    ] = None,
    latency: Annotated[
        str,
        typer.Option(
            help="From a question to when its answer acts, in simulated time: 80ms, 0.08s, or measured.",
            metavar="TIME",
        ),
    ] = "0ms",
    threshold: Threshold = None,
    time_limit: Annotated[
        float | None, typer.Option(min=0.001, help="Longest trial, simulated s.  [default: the task's]")
    ] = None,
    policy_timeout: Annotated[
        float, typer.Option(min=0.001, help="Real seconds that one answer of the policy may take.")
    ] = 30.0,
    trial_timeout: Annotated[
        float, typer.Option(min=1, help="Real seconds after which a trial's worker counts as hung.")
    ] = 600.0,
    min_success: MinSuccess = None,
    compare: Annotated[
        list[str] | None,
        typer.Option(
            help="Another policy on the same starts, or a report of --out; may be repeated.", metavar="POLICY|FILE.json"
        ),
    ] = None,
    out: ReportFile = None,
    html: Annotated[Path | None, typer.Option(help="Also write a leaderboard page.", metavar="FILE")] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film failures: all in one FILE.mp4, or one each in a folder.", metavar="PATH")
    ] = None,
    video_trials: Annotated[int, typer.Option(min=1, metavar="N", help="With --video: how many at most.")] = 10,
    video_all: Annotated[bool, typer.Option("--video-all", help="With --video: film successes too.")] = False,
    end: Annotated[
        Literal["success", "actor"],
        typer.Option(
            help="What ends a trial: success, once the goal has held for its hold time, or actor, the policy itself, "
            "so that the goal has to hold at the end."
        ),
    ] = "success",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Move older videos aside, and replace reports that exist.")
    ] = False,
    grasp: Grasp = None,
    randomize: Randomize = None,
    randomization: Randomization = None,
    size: Size = None,
    quality: Quality = None,
    task: Task = None,
    item: Object = None,
    target: Target = None,
    rig: Rig = None,
    revision: Revision = None,
    robot: Robot = None,
    arm: Arm = None,
    config: ConfigOption = "default",
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Run a policy from sampled starts, the same as `yamsim trials` has for that seed, and count its successes.

    Exit code 6 if the policy failed in every trial before its end, so that nothing was measured.

    Example: yamsim eval --policy my_policy.py:MyPolicy --n 50 --seed 0 --workers 2
    """
    if video_all and video is None:
        raise UsageError("--video-all is for videos: give --video")
    for flag, file in (("--out", out), ("--html", html)):
        if file is not None:
            require_free(flag, file, overwrite=overwrite)
    from yamsim_cli.core.policies.chunks import Chunking, read_latency
    from yamsim_cli.core.policies.loading import read_arguments, sees_images

    arguments, chunking = read_arguments(policy_arg or []), Chunking(execute, ensemble, read_latency(latency))
    others = compare or []

    session = opener.open(
        config,
        renders=video is not None or any(sees_images(name) for name in (policy, *others)),
        n=n,
        seed=seed,
        workers=workers,
        threshold=threshold,
        grasp=grasp,
        randomize=randomize,
        randomization=randomization,
        size=size,
        quality=quality,
        task=task,
        object=item,
        target=target,
        rig=rig,
        revision=revision,
        robot=robot,
        arm=arm,
        wrist=True,
    )

    from yamsim_cli.core.dataset.statistics import THRESHOLDS
    from yamsim_cli.core.documents.json_text import json_text
    from yamsim_cli.core.episode.rules import EndRule
    from yamsim_cli.core.evaluate import evaluation
    from yamsim_cli.core.evaluate.choice import PolicyChoice
    from yamsim_cli.core.evaluate.compare import compare as compared
    from yamsim_cli.core.evaluate.compare import read_report, require_same
    from yamsim_cli.core.files import write_output
    from yamsim_cli.core.trials import require_success, what_ran

    films = films_at(video, session.config, overwrite=overwrite) if video else None
    # Read first: a file that is no report, or one of other trials, is told before hours of trials.
    known = {name: read_report(Path(name)) for name in others if name.endswith(".json")}
    for told in known.values():
        require_same(what_ran(session.config), told)

    def run(choice: PolicyChoice) -> evaluation.Evaluation:
        with progress_bar("trials", "trials") as advance:
            return evaluation.evaluate(session, choice, advance, trial_timeout)

    choice = PolicyChoice(
        policy, Path.cwd(), policy_timeout, time_limit, EndRule(end), arguments, policy_config, chunking
    )
    found = run(choice)
    report = evaluation.summary(found, session.config, THRESHOLDS)
    reports = [report]
    for name in others:
        other = known.get(name) or evaluation.summary(run(choice.compared_with(name)), session.config, THRESHOLDS)
        reports.append(other)
    if others:
        report["compared"] = [compared(report, other) for other in reports[1:]]
    if films:
        report["videos"] = film(
            films,
            lambda told: evaluation.film(found, video_trials, films, session, told, successes=video_all),
        )
    if out is not None:
        write_output(out, json_text(report).encode())
        note(f"Written to {out}.")
    if html is not None:
        from yamsim_cli.core.summarize import write_leaderboard

        write_leaderboard(reports, report.get("compared", []), html)
        note(f"The page is in {html}.")
    if json:
        print_json(report)
    else:
        print_table(evaluation_table(report))
    evaluation.require_run(report)
    require_success(report["stats"], min_success)
