"""`yamsim correct`: record corrections of a policy's failures by the expert."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.flags import policy_options as policy_flags
from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.output_files import ContinueDataset, RenameExisting, open_mode
from yamsim_cli.flags.session_options import session_opener, session_settings
from yamsim_cli.terminal.console import note_moved, print_json, print_line, print_note, progress_bar
from yamsim_cli.terminal.signals import stop_on_signal

_STOPPING_NOTE = "Stopping once the trials in progress are done. Another signal stops immediately; --resume continues."


def correct(
    policy: Annotated[
        str,
        typer.Option(
            help="As for yamsim eval: module:Class, file.py:Class, act://HOST:PORT, ws://HOST:PORT, "
            "lerobot:CHECKPOINT, http://HOST:PORT, or hold_still.",
            show_default=False,
        ),
    ],
    n: Annotated[
        int, typer.Option("--n", min=1, help="Number of trials of the policy. The expert corrects failed trials.")
    ] = 50,
    seed: flags.Seed = None,
    workers: flags.Workers = None,
    out: Annotated[Path, typer.Option(help="The dataset's directory.")] = Path("corrections"),
    rewind_s: Annotated[
        float,
        typer.Option(
            min=0,
            max=600,
            metavar="SECONDS",
            help="Time between the takeover and the last motion of a failed trial, simulated s.",
        ),
    ] = 2.0,
    policy_arg: Annotated[
        list[str] | None,
        typer.Option(help="A keyword for your own policy's class; may be repeated.", metavar="KEY=VALUE"),
    ] = None,
    policy_config: policy_flags.PolicyConfig = None,
    execute: policy_flags.Execute = None,
    ensemble: policy_flags.Ensemble = None,
    latency: policy_flags.Latency = "0ms",
    time_limit: Annotated[
        float | None, typer.Option(min=0.001, help="Longest trial of the policy, simulated s.  [default: the task's]")
    ] = None,
    policy_timeout: policy_flags.PolicyTimeout = 30.0,
    trial_timeout: policy_flags.TrialTimeout = 600.0,
    grasp: flags.Grasp = None,
    wrist: flags.Wrist = None,
    camera: flags.Cameras = None,
    camera_effects: flags.CameraEffects = None,
    randomize: flags.Randomize = None,
    randomization: flags.Randomization = None,
    size: flags.Size = None,
    jpeg_quality: flags.JpegQuality = None,
    quality: flags.Quality = None,
    task: flags.Task = None,
    item: flags.Object = None,
    target: flags.Target = None,
    scene: flags.Scene = None,
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    robot: flags.Robot = None,
    arm: flags.Arm = None,
    resume: ContinueDataset = False,
    overwrite: RenameExisting = False,
    stage: flags.Stage = None,
    config: flags.ConfigOption = "default",
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Run a policy. If it fails, let the expert take over before the failure, and record both parts as an episode.

    Trial k starts as trial k of yamsim eval with the same seed. Use a seed with which nothing was recorded. Exit code
    6 if no trial was corrected.

    Example: yamsim correct --policy my_policy.py:MyPolicy --n 50 --seed 1000 --out corrections
    """
    mode = open_mode(resume=resume, overwrite=overwrite)
    from yamsim_cli.corrections.correct import correct as run
    from yamsim_cli.corrections.correct import correction_executor, require_corrections
    from yamsim_cli.policies.action_chunks import ChunkSettings, read_latency
    from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
    from yamsim_cli.policies.policy_loading import read_arguments
    from yamsim_cli.recording.collect import RecordCallbacks
    from yamsim_cli.recording.recording_output import RecordingOutput

    choice = PolicyChoice(
        policy,
        Path.cwd(),
        policy_timeout,
        time_limit,
        arguments=read_arguments(policy_arg or []),
        mapping=policy_config,
        chunking=ChunkSettings(execute, ensemble, read_latency(latency)),
    )
    session = session_opener.open(config, resumes=out if resume else None, **session_settings(locals()))
    executors = partial(correction_executor, choice=choice, rewind_s=rewind_s, job_seconds=trial_timeout)
    with progress_bar("correcting", "trials") as advance, stop_on_signal(_STOPPING_NOTE) as stop:
        callbacks = RecordCallbacks(
            lambda done, wanted, episodes: advance(done, wanted, f"{episodes} corrections"), print_note
        )
        report = run(session, policy, RecordingOutput(out, mode, stage), executors, callbacks, stop)
    note_moved(report.recorded.path, report.recorded.moved_aside)
    if json:
        print_json(report.data())
    else:
        print_line(report.describe())
    require_corrections(report)
