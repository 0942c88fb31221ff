"""Output without a terminal or without colours."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console

from tests.cli.run_cli import yamsim
from tests.cli.test_docs import COMMANDS, ROOT
from yamsim_cli.terminal.console import print_table, print_wrapped_text
from yamsim_cli.terminal.tables import ItemTable, NameValueTable
from yamsim_cli.terminal.trial_tables import evaluation_table, trials_table

LONG = "/data/" + "a_very_long_name/" * 8 + "[bold]x"
SPREAD = {"median": 0.1234, "p95": 0.2345, "max": 0.3456}
COUNTS: dict[str, Any] = {
    "n": 1000,
    "n_success": 987,
    "success_rate": 0.987,
    "wilson95": [0.9777, 0.9925],
    "threshold_m": 0.05,
    "rates": {"0.05": 0.987, "0.08": 0.99},
    "dxy_m": SPREAD,
    "causes": {"off_target": 13},
    "recovered": 0,
}
BATCH = COUNTS | {
    "task": "handover",
    "rig": "single_linear",
    "grasp": "contact",
    "margins": {
        "velocity_share": 0.92,
        "torque_share": 0.52,
        "joint_rad": 0.17,
        "slip_m": 0.0042,
        "object_tilt_rad": 0.03,
    },
    "trials": [{"trial": 12, "outcome": {"success": False, "detail": "250 mm from the plate's centre " * 4}}],
    "videos": [{"path": LONG}],
    "seconds": 12345.6,
    "core_seconds_per_trial": 12.34,
}
CHUNKS = {"chunks": 9000, "actions": 450000, "stale": 12000, "waited_s": 3.25}
INSTANCES = [{"instance": f"task-{k}", "n": 500, "n_success": 490, "wilson95": [0.963, 0.989]} for k in range(2)]
EVALUATION = {
    "task": "handover",
    "rig": "single_linear",
    "policy": LONG,
    "stats": COUNTS | {"policy_s": SPREAD, "slower_than_real_time": 0.5, "chunks": CHUNKS, "by_instance": INSTANCES},
    "tick_s": 0.032,
    "ticks_per_second": 812.4,
    "compared": [
        {
            "policy": LONG,
            "success_rate": 0.9,
            "both": 890,
            "only_first": 97,
            "only_second": 10,
            "neither": 3,
            "n": 1000,
            "difference": 0.087,
            "difference95": [0.067, 0.107],
            "p_value": 1.2e-16,
            "settings_differ": {},
        },
    ],
    "trials": [{"trial": 3, "ended": "policy_raised", "error": "ValueError: " + "a reason " * 20}],
    "seconds": 1.0,
}


@pytest.fixture
def piped(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment without terminal width and colours."""
    for name in ("COLUMNS", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "get_terminal_size", lambda *_: (_ for _ in ()).throw(OSError))


@pytest.mark.usefixtures("piped")
@pytest.mark.parametrize("path", ["", *COMMANDS])
def test_help_fits_80_columns_and_has_no_colours(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    # In this process, and with one parser: a process or a parser per command would take half a minute.
    with pytest.raises(SystemExit) as exited:
        ROOT([*path.split(), "--help"], prog_name="yamsim")
    assert exited.value.code == 0
    assert plain_and_narrow(capsys.readouterr().out)


@pytest.mark.usefixtures("piped")
def test_tables_fit_80_columns_and_lose_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    files = ItemTable(["name", "set", "size"], numbers_from=2)
    files.add_row(LONG, "ycb", "1.0 MB")
    for table in (trials_table(BATCH), evaluation_table(EVALUATION), NameValueTable([("dataset", LONG)]), files):
        print_table(table)
        out = capsys.readouterr().out
        assert plain_and_narrow(out)
        assert not any(line.endswith(" ") for line in out.splitlines())
        if table is not files:
            assert "".join(LONG.split()) in "".join(out.split())
    print_wrapped_text("ok", f"packages: {'numpy 2.4.6, ' * 20}", "green")
    assert plain_and_narrow(capsys.readouterr().out)


FILES = ("an_object_with_a_name.stl", "i2rt_yam_linear_4310", "1,234.5 MB")


@pytest.mark.parametrize("width", [32, 40, 59])
def test_a_narrow_terminal_breaks_no_words(width: int) -> None:
    listed = ItemTable(["name", "set", "size"], title="Files", numbers_from=2)
    listed.add_row(*FILES)
    listed.add_row("other.stl", "", "2 kB")
    told = [("distance from the centre", "median 123.4 mm, p95 234.5 mm"), ("task", "pickplace on single_linear")]
    for table, words in ((listed, " ".join(FILES)), (NameValueTable(told), " ".join(map(" ".join, told)))):
        console = Console(width=width, color_system=None, record=True, file=io.StringIO())
        console.print(table)
        lines = console.export_text().splitlines()
        assert max(map(cell_len, lines)) <= width
        assert set(words.split()) <= {word for line in lines for word in line.split()}


def test_values_stand_under_long_names_and_beside_short_ones() -> None:
    console = Console(width=40, color_system=None, record=True, file=io.StringIO())
    console.print(NameValueTable([("distance from the centre", "median 123.4 mm")]))
    console.print(NameValueTable([("size", "1.0 MB"), ("seed", "0")]))
    told = [line.rstrip() for line in console.export_text().splitlines()]
    assert told == ["distance from the centre", "  median 123.4 mm", "size  1.0 MB", "seed  0"]


def test_a_narrow_terminal_has_all_problems(capsys: pytest.CaptureFixture[str]) -> None:
    listed = ItemTable(["problem", "times", "what, where, and what to do"], title="1 error", numbers_to=2, whole=True)
    listed.add_row("manifest.missing", "1", "manifest.json: the manifest is missing")
    console = Console(width=40, color_system=None, file=sys.stdout)
    console.print(listed)
    told = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert told == [
        "",
        "1 error",
        "manifest.missing",
        "  times",
        "    1",
        "  what, where, and what to do",
        "    manifest.json: the manifest is",
        "    missing",
    ]


def test_a_pipe_has_no_colours() -> None:
    assert "\x1b" not in yamsim("config", "list").out
    assert "\x1b" not in yamsim("--help").out


def test_a_terminal_has_colours_unless_they_are_not_wanted(repository: Path) -> None:
    coloured, plain = (on_terminal(("record", "--help"), repository, environ) for environ in ({}, {"NO_COLOR": "1"}))
    assert b"\x1b[" in coloured
    # Bold and dim are no colours, and stay.
    assert not any(colour in plain for colour in (b"\x1b[3", b"\x1b[9", b";3"))


def on_terminal(arguments: tuple[str, ...], repository: Path, environ: dict[str, str]) -> bytes:
    """Return the output of a command in a terminal of 80 columns."""
    ours, its = pty.openpty()
    unset = ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "TERM")
    kept = {key: value for key, value in os.environ.items() if key not in unset}
    process = subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", *arguments],
        stdin=its,
        stdout=its,
        stderr=its,
        cwd=repository,
        env={**kept, "TERM": "xterm-256color", **environ},
    )
    os.close(its)
    said = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # the terminal's other end is closed
            break
        if not part:
            break
        said += part
    os.close(ours)
    assert process.wait(30) == 0
    return said


def plain_and_narrow(text: str) -> bool:
    """Whether no line is wider than 80 columns and nothing is an escape."""
    return "\x1b" not in text and max(map(cell_len, text.splitlines())) <= 80


def test_a_narrow_check_can_fail() -> None:
    assert not plain_and_narrow("x" * 81)
    assert Console(width=80).width == 80
