"""`yamsim serve-robot` and `yamsim can-run` as a user types them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim


def test_it_serves_for_as_long_as_it_is_told_and_says_how_well(tmp_path: Path) -> None:
    run = yamsim("serve-robot", "--seconds", "0.2", "--folder", tmp_path / "buses", "--json")
    assert run.code == 0, run.err
    assert run.json["channels"] == ["can0"]
    assert run.json["steps"] == pytest.approx(100, abs=1)
    # The folder is empty afterwards.
    assert list((tmp_path / "buses").iterdir()) == []


def test_any_task_is_served(tmp_path: Path) -> None:
    flags = ("--task", "tower", "--start", "task", "--rig", "single_linear")
    run = yamsim("serve-robot", "--seconds", "0.2", "--folder", tmp_path / "buses", *flags)
    assert run.code == 0, run.err


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (["--fault", "lost:motor=9"], 2, "9; valid: 1, 2"),
        (["--start", "up"], 2, "--start 'up' is not valid; valid: rest, home, task"),
        (["--rig", "yam_v1+linear_3507"], 3, "linear_3507"),
        (["--channel", "can0", "--channel", "can1"], 2, "give 1 different names"),
    ],
)
def test_what_it_cannot_serve_is_one_line(flags: list[str], code: int, says: str, tmp_path: Path) -> None:
    run = yamsim("serve-robot", "--seconds", "0.2", "--folder", tmp_path / "buses", *flags)
    assert run.code == code, run.err
    assert says in run.message


def test_can_run_needs_a_server(tmp_path: Path) -> None:
    run = yamsim("can-run", "--folder", tmp_path, "--", "true")
    assert run.code == 4
    assert str(tmp_path) in run.message and "yamsim serve-robot" in run.message
