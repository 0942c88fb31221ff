from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError, count_noun
from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.output_files import RenameExisting, open_mode
from yamsim_cli.flags.session_options import session_opener, session_settings
from yamsim_cli.flags.viewer_options import Host, Port, page_address, silence_viser
from yamsim_cli.terminal.console import print_json, print_line, print_note
from yamsim_cli.terminal.signals import stop_on_signal

if TYPE_CHECKING:
    from yamsim_cli.viewers.teleop.teleop_session import TeleopReport

_STOP_SIGNAL_NOTE = (
    "Ending once recorded attempts are judged and rendered. Another signal ends immediately; whole episodes are safe."
)


def teleop(
    stream: Annotated[
        Path | None,
        typer.Option("--input", metavar="STREAM.jsonl", help="File of timed commands, in place of the page."),
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="With --input: run in real time instead of as fast as possible.")
    ] = False,
    out: Annotated[Path, typer.Option(help="The dataset's directory.")] = Path("teleop"),
    seed: flags.Seed = None,
    task: flags.Task = None,
    item: flags.Object = None,
    target: flags.Target = None,
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    robot: flags.Robot = None,
    arm: flags.Arm = None,
    wrist: flags.Wrist = None,
    size: flags.Size = None,
    quality: flags.Quality = None,
    time_limit: Annotated[
        float, typer.Option(min=1, max=3600, help="Seconds after which a recording is stopped and judged.")
    ] = 600.0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Add to a dataset; attempts of a killed session are judged first.")
    ] = False,
    overwrite: RenameExisting = False,
    port: Port = None,
    host: Host = None,
    config: flags.ConfigOption = "default",
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Teleoperate the arm from a browser page or by a command stream, and record successes. Ctrl-C ends the session.

    Example: yamsim teleop --out teleop
    """
    mode = open_mode(resume=resume, overwrite=overwrite)
    for flag, given in (("--port", port is not None), ("--host", host is not None)):
        if stream is not None and given:
            raise UsageError(f"{flag} is for the page: leave it out, or leave out --input")
    if realtime and stream is None:
        raise UsageError("--realtime is for --input; the page always keeps to the clock")
    session = session_opener.open(config, resumes=out if resume else None, **session_settings(locals()))
    silence_viser()

    from yamsim_cli.viewers.teleop.command_stream import read_stream
    from yamsim_cli.viewers.teleop.teleop_session import check_page, open_teleop, run_page, run_stream

    commands = None if stream is None else read_stream(stream, session.config)
    page = None if commands else page_address(port, host)
    if page is not None:
        check_page(page)

    def announce_ready(url: str) -> None:
        print_note(f"{url}  (Ctrl-C ends)")
        sys.stderr.flush()

    with (
        stop_on_signal(_STOP_SIGNAL_NOTE) as stop,
        open_teleop(session, out, mode, print_note, time_limit=time_limit) as teleop_session,
    ):
        if page is None:
            assert commands is not None
            report = run_stream(teleop_session, commands, stop, realtime=realtime)
        else:
            report = run_page(teleop_session, session.config, page, announce_ready, stop)
    _print(report, json)


def _print(report: TeleopReport, json: bool) -> None:
    if json:
        print_json(_summary_json(report))
        return
    for trial in report.trials:
        end = f"episode {trial.episode}" if trial.episode is not None else f"failed: {trial.outcome.detail}"
        print_line(f"attempt {trial.attempt}: {end}")
    if (jitter := report.jitter) is not None:
        print_line(
            f"{jitter.ticks} control ticks at {jitter.rate_hz:.2f} Hz; time error {jitter.p50:.2f} ms (median), "
            f"{jitter.p95:.2f} ms (95 %), {jitter.max:.2f} ms (largest); {jitter.late} late, {jitter.lost:.0f} ms lost"
        )
    print_line(
        f"{count_noun(report.episodes, 'episode')} from {count_noun(report.attempts, 'attempt')} in {report.path}"
    )


def _summary_json(report: TeleopReport) -> dict[str, Any]:
    return {
        "episodes": report.episodes,
        "attempts": report.attempts,
        "discarded": report.discarded,
        "path": str(report.path),
        "trials": [
            {"attempt": trial.attempt, "episode": trial.episode, **trial.outcome.model_dump()}
            for trial in report.trials
        ],
        "jitter_ms": asdict(report.jitter) if report.jitter else None,
    }
