"""`yamsim import` as a user runs it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.real.recordings.making import swinging, write_csv
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations


@pytest.fixture
def log(locations: Locations, tmp_path: Path) -> Path:
    rig = load_config(RigConfig, "rigs", "single", locations)
    return write_csv(tmp_path / "log.csv", swinging(rig, 0.5), rig)


def test_a_log_comes_in_and_is_summarized(log: Path, tmp_path: Path) -> None:
    run = yamsim("import", "log.csv", cwd=tmp_path)
    assert (run.code, run.out.strip()) == (0, "real: 1 episode, 50 frames, source: real")
    summary = yamsim("summarize", "real", "--strict", "--json", cwd=tmp_path)
    assert summary.code == 0, summary.err
    assert (summary.json["real"], summary.json["recorded_by_yamsim"], summary.json["frames"]) == (True, False, 50)
    again = yamsim("import", "log.csv", cwd=tmp_path)
    assert (again.code, "--resume" in again.message) == (2, True)
    resumed = yamsim("import", "log.csv", "--resume", "--json", cwd=tmp_path)
    assert (resumed.json["episodes"], resumed.json["kept"]) == (0, 1)


def test_what_cannot_be_done_with_a_real_recording_says_so(log: Path, tmp_path: Path) -> None:
    assert yamsim("import", "log.csv", cwd=tmp_path).code == 0
    run = yamsim("import", "real", "--out", "again", cwd=tmp_path)
    assert (run.code, "needs no import" in run.message) == (4, True)
    run = yamsim("overlay", "--episode", "real/ep_000000", cwd=tmp_path)
    assert (run.code, "real/ep_000000" in run.message) == (4, True)
    run = yamsim("verify", "real", cwd=tmp_path)
    assert (run.code, "not simulated" in run.message) == (4, True)
    assert "yamsim summarize real --strict" in run.message
    film = yamsim("replay", "real/ep_000000", "--video", "film.mp4", cwd=tmp_path)
    assert (film.code, "real/ep_000000" in film.message) == (4, True)
    anew = yamsim("replay", "real/ep_000000", "--video", "film.mp4", "--render", cwd=tmp_path)
    assert (anew.code, "was not simulated" in anew.message) == (2, True)


def test_a_real_dataset_is_exported(log: Path, tmp_path: Path) -> None:
    assert yamsim("import", "log.csv", cwd=tmp_path).code == 0
    run = yamsim("export", "lerobot", "real", "out", "--json", cwd=tmp_path)
    assert (run.json["episodes"], run.json["frames"], run.json["notes"]) == (1, 50, [])
    slower = yamsim("export", "lerobot", "real", "slower", "--fps", "20", cwd=tmp_path)
    assert slower.out.strip() == "1 episode, 10 frames in slower"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["mp4", "real", "out"], 4, "real has no pictures"),
        (["lerobot", "real", "out", "--environment-state"], 2, "the poses of its objects were not recorded"),
        (["lerobot", "real", "out", "--episodes", "7"], 2, "has no episode 7"),
        (["lerobot", "real", "out", "--fps", "0"], 2, "--fps"),
    ],
)
def test_exports_that_need_simulation_are_refused_for_real_datasets(
    log: Path, tmp_path: Path, arguments: list[str], code: int, message: str
) -> None:
    assert yamsim("import", "log.csv", cwd=tmp_path).code == 0
    run = yamsim("export", *arguments, cwd=tmp_path)
    assert (run.code, message in run.message) == (code, True), run.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["no.csv"], 4, "no.csv"),
        (["log.csv", "--rig", "russet"], 4, "position_left_joint1"),
        (["log.csv", "--swap-arms"], 2, "the rig has one arm"),
        (["log.csv", "--resume", "--overwrite"], 2, "give one of them"),
        (["log.csv", "--format", "lerobot"], 4, "meta/info.json cannot be read"),
        (["."], 4, "valid: a .csv"),
        (["log.csv", "--mirror-gripper", "no"], 2, "--mirror-gripper"),
    ],
)
def test_impossible_imports_are_refused_in_one_line(
    log: Path, tmp_path: Path, arguments: list[str], code: int, message: str
) -> None:
    run = yamsim("import", *arguments, cwd=tmp_path)
    assert (run.code, message in run.message) == (code, True), run.err
    assert not (tmp_path / "real").exists()
