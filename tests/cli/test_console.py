"""Progress in a log, without a terminal."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from collections.abc import Callable

import pytest
from rich.console import Console

from yamsim_cli.terminal import console
from yamsim_cli.terminal.console import progress_bar
from yamsim_cli.terminal.fetch_bar import fetch_bar


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Set the clock, s, without a terminal."""
    now = 1000.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)

    def set_clock(seconds: float) -> None:
        nonlocal now
        now = 1000.0 + seconds

    return set_clock


def test_a_line_every_half_minute(at: Callable[[float], None], capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("recording", "episodes") as advance:
        for second in range(0, 101, 5):
            at(second)
            advance(second // 5, 500, f"{second // 4} attempts")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "recording: 6 of 500 episodes, 12.0 episodes/min, 0:41:10 left, 7 attempts",
        "recording: 12 of 500 episodes, 12.0 episodes/min, 0:40:40 left, 15 attempts",
        "recording: 18 of 500 episodes, 12.0 episodes/min, 0:40:10 left, 22 attempts",
    ]


def test_a_short_job_is_silent(at: Callable[[float], None], capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("trials", "trials") as advance:
        advance(0, 2, "")
        at(29.9)
        advance(2, 2, "")
    assert capsys.readouterr().err == ""


def test_what_was_done_before_is_not_this_jobs_speed(
    at: Callable[[float], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with progress_bar("recording", "episodes", log_seconds=60) as advance:
        advance(480, 500, "")
        at(60)
        advance(490, 500, "")
    assert capsys.readouterr().err == "recording: 490 of 500 episodes, 10.0 episodes/min, 0:01:00 left\n"


def test_without_a_pace_there_is_no_time_left(at: Callable[[float], None], capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("recording", "episodes") as advance:
        advance(0, 500, "0 attempts")
        at(45)
        advance(0, 500, "9 attempts")
    assert capsys.readouterr().err == "recording: 0 of 500 episodes, 9 attempts\n"


def test_a_command_tells_its_progress_on_stderr_beside_json() -> None:
    code = (
        "import sys; from yamsim_cli.terminal import console; console._LOG_PERIOD_SECONDS = 0.0\n"
        "sys.argv = ['yamsim', 'pickplace', 'batch', '--n', '2', '--workers', '1', '--json']\n"
        "from yamsim_cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("{\n")
    assert done.stdout.endswith("}\n")
    lines = done.stderr.splitlines()
    assert lines[0] == "trials: 1 of 2 trials"
    assert re.fullmatch(r"trials: 2 of 2 trials, [0-9.]+ trials/min, 0:00:00 left", lines[1])
    assert len(lines) == 2


def fetched(monkeypatch: pytest.MonkeyPatch, *, on_terminal: bool) -> str:
    """Collect the output of the fetch bar, 80 columns wide."""
    file = io.StringIO()
    monkeypatch.setattr(console, "console", Console(file=file, force_terminal=on_terminal, width=80))
    with fetch_bar() as advance:
        advance("i2rt_yam_linear_4310: dreamscale-i2rt 1.3.6.post1", 14_200_000, 33_000_000)
        advance("finray: made here", 25_500, 25_500)
    return file.getvalue()


def test_a_fetchs_bar_names_sizes_of_any_scale_and_is_gone_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    written = fetched(monkeypatch, on_terminal=True)
    assert "25.5 kB of 25.5 kB" in written
    assert written.endswith("\r\x1b[1A\x1b[2K")  # The cursor is on the bar's line, which is empty.


def test_a_fetch_without_a_terminal_shows_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fetched(monkeypatch, on_terminal=False).strip() == ""
