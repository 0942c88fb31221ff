"""yamsim from Python: the README's example, and the same bytes as the command line's."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import yamsim_cli
from tests.e2e.test_record_summarize import digest
from tests.pages import snippet
from tests.unrendered import frame_count
from yamsim_cli.commands.evaluate import evaluate as evaluate_command
from yamsim_cli.core.errors import ConfigError, UsageError

pytestmark = pytest.mark.render


@pytest.mark.slow
def test_the_readmes_example_records_an_episode(repository: Path, tmp_path: Path) -> None:
    code = snippet("python", "from yamsim_cli import open_dataset, record")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(repository)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "1 episode from 1 attempts in my_dataset" in done.stdout
    episode = tmp_path / "my_dataset" / "ep_000000"
    frames = frame_count(episode)
    assert re.search(rf"^{frames} frames, \d\.\d mm off$", done.stdout, re.MULTILINE)
    pictures = sorted((episode / "rgb" / "right_wrist_camera").iterdir())
    assert [file.name for file in pictures] == [f"{k:06d}.jpg" for k in range(frames)]


@pytest.mark.slow
def test_it_records_the_same_bytes_in_this_process_and_in_others(tmp_path: Path) -> None:
    options = {"episodes": 2, "seed": 4, "size": (64, 48)}
    here = yamsim_cli.record(tmp_path / "here", **options)
    there = yamsim_cli.record(tmp_path / "there", workers=2, **options)
    assert (here.episodes, there.episodes) == (2, 2)
    assert digest(here.path) == digest(there.path)
    more = yamsim_cli.record(tmp_path / "here", **options | {"episodes": 3}, resume=True)
    assert [episode.record.attempt for episode in yamsim_cli.open_dataset(more.path)] == [0, 1, 2]


def test_errors_name_the_keyword(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'singl'"):
        yamsim_cli.record(tmp_path / "out", rig="singl")
    with pytest.raises(UsageError, match=r"^arm=: "):
        yamsim_cli.record(tmp_path / "out", arm="left")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    with pytest.raises(UsageError, match=str(tmp_path / "full")):
        yamsim_cli.record(tmp_path / "full")
    with pytest.raises(AttributeError, match="no attribute 'recrod'"):
        yamsim_cli.recrod  # noqa: B018


def test_neither_typer_nor_rich_is_loaded() -> None:
    script = (
        "import sys\n"
        "from yamsim_cli import evaluate, open_dataset, record\n"
        "import yamsim_cli.gym_env, yamsim_cli.kinematics\n"
        "record.__call__, evaluate.__call__, open_dataset.__call__\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules} & {'typer', 'rich', 'click'}))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_evaluate_has_the_flags_of_the_command() -> None:
    """Except those that write files or end the process, which a program does itself."""
    outputs = {"out", "html", "json", "video", "video_trials", "video_all", "overwrite", "offline", "min_success"}
    command = set(inspect.signature(evaluate_command).parameters) - outputs
    keywords = set(inspect.signature(yamsim_cli.evaluate).parameters)
    assert keywords == {{"item": "object", "policy_arg": "policy_args"}.get(name, name) for name in command}


def test_evaluate_returns_what_the_command_prints() -> None:
    report = yamsim_cli.evaluate("hold_still", n=2, seed=1, time_limit=0.5, execute=3, size=(64, 48))
    assert (report["settings"]["execute"], report["settings"]["size_px"]) == (3, [64, 48])
    assert (report["stats"]["n"], report["stats"]["success_rate"], len(report["trials"])) == (2, 0.0, 2)


@pytest.mark.parametrize("name", yamsim_cli.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(yamsim_cli, name).__name__ == name
