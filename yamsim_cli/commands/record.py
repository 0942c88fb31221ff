"""`yamsim record`: record a dataset."""

from __future__ import annotations

import os
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from yamsim_cli.core.errors import UsageError, count_noun
from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.output_files import ContinueDataset, RenameExisting, open_mode
from yamsim_cli.flags.session_options import session_opener, session_settings
from yamsim_cli.terminal.console import note_moved, print_json, print_line, print_note, progress_bar
from yamsim_cli.terminal.signals import stop_on_signal

if TYPE_CHECKING:
    from yamsim_cli.early_worker import EarlyWorker
    from yamsim_cli.recording.executor_factories import ExecutorFactory
    from yamsim_cli.recording.recorder import RecordReport

_STOP_SIGNAL_NOTE = (
    "Stopping once the attempts in progress are done. Another signal stops immediately; nothing is lost either way."
)


def record(
    n: Annotated[int | None, typer.Option("--n", help="Number of successful episodes in the dataset.")] = None,
    workers: flags.Workers = None,
    seed: flags.Seed = None,
    out: Annotated[Path, typer.Option(help="The dataset's directory.")] = Path("dataset"),
    task: flags.Task = None,
    item: flags.Object = None,
    target: flags.Target = None,
    scene: flags.Scene = None,
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    robot: flags.Robot = None,
    arm: flags.Arm = None,
    grasp: flags.Grasp = None,
    wrist: flags.Wrist = None,
    camera: flags.Cameras = None,
    camera_effects: flags.CameraEffects = None,
    randomize: flags.Randomize = None,
    randomization: flags.Randomization = None,
    disturb: flags.Disturb = False,
    boards: flags.Boards = None,
    no_images: Annotated[
        bool,
        typer.Option("--no-images", help="Record physics without images; `yamsim draw` renders them later."),
    ] = False,
    truth: Annotated[
        bool | None, typer.Option("--truth/--no-truth", help="Also record depth, segmentation, keypoints and boxes.")
    ] = None,
    action: Annotated[
        Literal["drives", "joints"] | None,
        typer.Option(
            help="joints: also record state and action as real YAM stations do: each arm's joints, and its "
            "gripper's opening from 0 to 1; needs --grasp contact.  [default: drives]"
        ),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(min=1, max=100, help="Frames a second: 30, 15 or 10.  [default: 15.625]")
    ] = None,
    size: flags.Size = None,
    jpeg_quality: flags.JpegQuality = None,
    quality: flags.Quality = None,
    resume: ContinueDataset = False,
    overwrite: RenameExisting = False,
    stage: flags.Stage = None,
    executor: Annotated[
        Literal["process", "ray"], typer.Option(help="Workers: processes of this machine, or actors of a Ray cluster.")
    ] = "process",
    address: Annotated[
        str | None,
        typer.Option(help="Address of a running Ray cluster, such as auto; without it, a cluster is started here."),
    ] = None,
    attempt_timeout: flags.AttemptTimeout = 600.0,
    config: flags.ConfigOption = "default",
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Record successful episodes of a task into a dataset. Each episode is written completely or not at all.

    Example: yamsim record --n 500 --workers 4
    """
    mode = open_mode(resume=resume, overwrite=overwrite)
    settings = session_settings(locals())
    if no_images:
        given = {"--camera": camera, "--camera-effects": camera_effects, "--truth": truth, "--wrist": wrist}
        if flag := next((name for name, value in given.items() if value), None):
            raise UsageError(
                f"{flag} and --no-images contradict each other; leave one out, or give {flag} to yamsim draw"
            )
        settings["camera"] = ()  # an empty list, not a setting that is left out
    if executor == "process" and address is not None:
        raise UsageError("--address needs --executor ray")
    with _start_worker() if executor == "process" else nullcontext() as early:
        session = session_opener.open(config, renders=not no_images, resumes=out if resume else None, **settings)

        from yamsim_cli.recording.collect import RecordCallbacks
        from yamsim_cli.recording.recorder import record as run
        from yamsim_cli.recording.recording_output import RecordingOutput

        executors = _make_executor_factory(early, address, attempt_timeout)
        with progress_bar("recording", "episodes") as advance, stop_on_signal(_STOP_SIGNAL_NOTE) as stop:
            callbacks = RecordCallbacks(
                lambda done, wanted, attempts: advance(done, wanted, f"{attempts} attempts"), print_note
            )
            report = run(session, RecordingOutput(out, mode, stage), executors, callbacks, stop)
    _print(report, json)


def _start_worker() -> EarlyWorker:
    from yamsim_cli.early_worker import EarlyWorker

    return EarlyWorker()


def _make_executor_factory(early: EarlyWorker | None, address: str | None, attempt_timeout: float) -> ExecutorFactory:
    """Return a factory of processes if there is an `early` worker, else one of Ray actors."""
    from yamsim_cli.recording.executor_factories import process_executor, ray_executor

    if early is not None:
        return partial(process_executor, job_seconds=attempt_timeout, early=early)
    # Ray would otherwise send usage statistics over the network.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    rendering = {name: os.environ[name] for name in ("MUJOCO_GL", "LP_NUM_THREADS") if name in os.environ}
    return partial(ray_executor, address=address, environ=rendering, job_seconds=attempt_timeout)


def _print(report: RecordReport, json: bool) -> None:
    note_moved(report.path, report.moved_aside)
    if json:
        print_json(
            {
                "episodes": report.episodes,
                "attempts": report.attempts,
                "seconds": round(report.seconds, 3),
                "path": str(report.path),
                "moved_aside": str(report.moved_aside) if report.moved_aside else None,
            }
        )
    else:
        print_line(
            f"{count_noun(report.episodes, 'episode')} from {count_noun(report.attempts, 'attempt')} in {report.path} "
            f"({report.seconds:.1f} s)"
        )
