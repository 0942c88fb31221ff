from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags import policy_options as policy_flags
from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.output_files import ReportFile, VideoTrials, require_unused_reports, write_json_report
from yamsim_cli.flags.session_options import session_opener, session_settings
from yamsim_cli.kitchen_scenes import ABC_TASK
from yamsim_cli.terminal.console import print_note, print_report, progress_bar
from yamsim_cli.terminal.trial_tables import evaluation_table, film_with_progress, open_films

if TYPE_CHECKING:
    from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice


def evaluate(
    policy: Annotated[
        str | None,
        typer.Option(
            help="module:Class, file.py:Class, act://HOST:PORT, ws://HOST:PORT, lerobot:CHECKPOINT, http://HOST:PORT, "
            "scripted, hold_still, or replay:DATASET. Not needed to compare reports.",
        ),
    ] = None,
    n: Annotated[int, typer.Option("--n", min=1, help="Trials.")] = 50,
    seed: flags.Seed = None,
    workers: flags.Workers = None,
    policy_arg: Annotated[
        list[str] | None,
        typer.Option(
            help="A keyword for your own policy's class, and for compared classes that accept it; may be repeated.",
            metavar="KEY=VALUE",
        ),
    ] = None,
    policy_config: policy_flags.PolicyConfig = None,
    trained_on: Annotated[
        Path | None,
        typer.Option(
            metavar="DATASET",
            help="The policy's training dataset: gives image size and quality, unless flags do. eval reports how "
            "trials differ from it.  [default: the dataset in the policy's config or checkpoint]",
        ),
    ] = None,
    execute: policy_flags.Execute = None,
    ensemble: policy_flags.Ensemble = None,
    latency: policy_flags.Latency = "0ms",
    threshold: flags.Threshold = None,
    time_limit: Annotated[
        float | None, typer.Option(min=0.001, help="Longest trial, simulated s.  [default: the task's]")
    ] = None,
    policy_timeout: policy_flags.PolicyTimeout = 30.0,
    trial_timeout: policy_flags.TrialTimeout = 600.0,
    min_success: flags.MinSuccess = None,
    compare: Annotated[
        list[str] | None,
        typer.Option(
            help="Another policy on the same starts, or a report of --out; may be repeated. Without --policy, the "
            "first report is compared with the others.",
            metavar="POLICY|FILE.json",
        ),
    ] = None,
    out: ReportFile = None,
    html: Annotated[Path | None, typer.Option(help="Also write a leaderboard page.", metavar="FILE")] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            help="Record videos of failures: one FILE.mp4 of all, or a file for each in a folder.", metavar="PATH"
        ),
    ] = None,
    video_trials: VideoTrials = 10,
    video_all: Annotated[bool, typer.Option("--video-all", help="With --video: also record successes.")] = False,
    end: Annotated[
        Literal["success", "actor"],
        typer.Option(
            help="What ends a trial: success (the goal has held for its hold time), or actor (the policy ends it, and "
            "the goal must hold then)."
        ),
    ] = "success",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Rename older videos, and replace reports.")] = False,
    grasp: flags.Grasp = None,
    randomize: flags.Randomize = None,
    randomization: flags.Randomization = None,
    size: flags.Size = None,
    quality: flags.Quality = None,
    task: flags.Task = None,
    item: flags.Object = None,
    target: flags.Target = None,
    scene: flags.Scene = None,
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    robot: flags.Robot = None,
    arm: flags.Arm = None,
    config: flags.ConfigOption = "default",
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Run a policy from the sampled starts of `yamsim trials` for the same seed, and count its successes.

    Exit code 6 if no trial ran to its end, so that no success rate was measured.

    Without --policy, compare reports that --out wrote.

    With --task abc/put_bottles, run ABC's simulated evaluation: its scene, starts and success rule.

    Example: yamsim eval --policy my_policy.py:MyPolicy --n 50 --seed 0 --workers 2
    """
    if video_all and video is None:
        raise UsageError("--video-all needs --video; give --video too, or leave --video-all out")
    require_unused_reports(out, html, overwrite=overwrite)
    others = compare or []
    if policy is None:
        report, reports = _compare_files(others)
        _write_reports(report, reports, out, html)
        print_report(report, lambda: evaluation_table(report), json)
        return
    from yamsim_cli.core.episode.episode_rules import EndRule
    from yamsim_cli.policies.action_chunks import ChunkSettings, read_latency
    from yamsim_cli.policies.evaluate import evaluation
    from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
    from yamsim_cli.policies.evaluate.run import evaluate_and_compare, open_evaluation_session
    from yamsim_cli.policies.policy_loading import read_arguments
    from yamsim_cli.trials import require_success

    arguments, chunking = read_arguments(policy_arg or []), ChunkSettings(execute, ensemble, read_latency(latency))
    choice = PolicyChoice(
        policy, Path.cwd(), policy_timeout, time_limit, EndRule(end), arguments, policy_config, chunking
    )
    if task == ABC_TASK:
        report, reports = _evaluate_abc(choice, others, session_settings(locals()), locals())
    else:
        session, training = open_evaluation_session(
            session_opener, config, choice, others, trained_on, renders=video is not None, **session_settings(locals())
        )
        films = open_films(video, session.config, overwrite=overwrite) if video else None
        found = evaluate_and_compare(
            session,
            choice,
            others,
            trial_timeout,
            training,
            lambda: progress_bar("trials", "trials"),
            session_opener.notify,
        )
        report, reports = found.report, found.others
        if films:
            report["videos"] = film_with_progress(
                films,
                lambda shown: evaluation.film_evaluation(
                    found.evaluation, video_trials, films, session, shown, successes=video_all
                ),
            )
    _write_reports(report, reports, out, html)
    print_report(report, lambda: evaluation_table(report), json)
    evaluation.require_measured_trials(report)
    require_success(report["stats"], min_success)


def _evaluate_abc(
    choice: PolicyChoice, others: list[str], settings: dict[str, Any], given: dict[str, Any]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Evaluate a policy in ABC's own scene. `given` are the command's parameters, `settings` the session's."""
    from yamsim_cli.abc_evaluation.evaluation import (
        DEFAULT_SEED,
        DEFAULT_SIZE,
        BottlesEvaluation,
        require_supported_flags,
    )
    from yamsim_cli.abc_evaluation.model_files import find_model_folder
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.policies.policy_loading import may_read_images
    from yamsim_cli.session_opener import parse_size

    unused = settings.keys() - {"task", "workers", "seed", "size", "n"}
    values = {name: settings[name] for name in unused} | {
        "trained_on": given["trained_on"],
        "video": given["video"],
        "config": None if given["config"] == "default" else given["config"],
        "end": None if given["end"] == "success" else given["end"],
    }
    require_supported_flags({f"--{name.replace('_', '-')}": values[name] for name in sorted(values)})
    folder, locations = find_model_folder(session_opener.environ), session_opener.find_locations()
    if any(may_read_images(name) for name in (choice.name, *others)):
        locations = session_opener.choose_gl_backend(locations, workers=True)
    else:
        session_opener.disable_gl()
    evaluation = BottlesEvaluation(
        folder,
        locations,
        n=given["n"],
        seed=DEFAULT_SEED if given["seed"] is None else given["seed"],
        workers=RecordConfig.model_fields["workers"].default if given["workers"] is None else given["workers"],
        size=parse_size(given["size"]) if given["size"] else DEFAULT_SIZE,
        trial_seconds=given["trial_timeout"],
        watch=lambda: progress_bar("trials", "trials"),
    )
    return evaluation.evaluate(choice, others)


def _compare_files(names: list[str]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    if len(names) < 2 or not all(name.endswith(".json") for name in names):
        raise UsageError("give --policy, or two reports of --out to compare: --compare A.json --compare B.json")
    from yamsim_cli.policies.evaluate.run import compare_report_files

    return compare_report_files(names)


def _write_reports(report: dict[str, Any], others: list[dict[str, Any]], out: Path | None, html: Path | None) -> None:
    write_json_report(report, out)
    if html is not None:
        from yamsim_cli.datasets.summarize import write_leaderboard

        write_leaderboard([report, *others], report.get("compared", []), html)
        print_note(f"The page is in {html}.")
