"""`yamsim eval --task abc/put_bottles` as a user runs it.

Runs use a miniature of ABC's scene, which takes the place of the commit's model files.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

from tests.abc_evaluation.miniature import write_miniature
from tests.cli.run_cli import Run, yamsim
from tests.cli.warm import REPOSITORY

EVAL = ("eval", "--task", "abc/put_bottles")
SEED = 20260511  # Source: amazon-far/abc e5e1fbc, `SimEvalConfig.seed` of abc_minimal/config.py

# The executable. It accepts the files of a folder in place of the files of the commit.
PROGRAM = """
from pathlib import Path

from yamsim_cli.abc_evaluation import model_files

if __name__ == "__main__":
    model_files.MODEL_TREE = model_files.git_tree_id(Path({folder!r}))
    from yamsim_cli.__main__ import main

    main()
"""

POLICY = """
import numpy as np


class Turning:
    images = ()

    def reset(self):
        pass

    def __call__(self, observation):
        print("this must not get into the report")
        ctrl = np.tile(observation["joints"], (30, 1))
        ctrl[:, 0] += 0.01 * np.arange(1, 31)
        return {"ctrl": ctrl, "period": 1 / 30}


class Failing(Turning):
    def __call__(self, observation):
        raise KeyError("no such thing")
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder that stands in for the checkout, with `policies.py` beside it."""
    write_miniature(tmp_path / "checkout" / "assets" / "put_bottles")
    (tmp_path / "policies.py").write_text(POLICY)
    return tmp_path / "checkout"


def evaluate(checkout: Path, *flags: str | Path) -> Run:
    """Run the command in the folder beside the checkout, with one worker."""
    program = checkout.parent / "program.py"
    program.write_text(PROGRAM.format(folder=str(checkout / "assets" / "put_bottles")))
    done = subprocess.run(
        [sys.executable, str(program), *EVAL, "--workers", "1", *map(str, flags)],
        cwd=checkout.parent,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), "YAMSIM_ABC": str(checkout)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return Run(done.returncode, done.stdout, done.stderr)


def test_without_a_checkout_the_message_says_how_to_get_one() -> None:
    run = yamsim(*EVAL, "--policy", "scripted", "--n", "1", env={"YAMSIM_ABC": ""})
    assert run.code == 4
    assert run.out == ""
    assert run.message == (
        "the task put_bottles needs ABC's model files, and YAMSIM_ABC is not set: clone the repository "
        "amazon-far/abc, check out e5e1fbc, and set YAMSIM_ABC to its folder"
    )


def test_other_model_files_are_refused(checkout: Path) -> None:
    words = (*EVAL, "--policy", "scripted", "--n", "1")
    run = yamsim(*words, env={"YAMSIM_ABC": str(checkout)})
    assert (run.code, run.out) == (4, "")
    folder = checkout / "assets" / "put_bottles"
    assert run.message.startswith(f"YAMSIM_ABC: {folder} differs from commit e5e1fbc of amazon-far/abc: its git tree")
    run = yamsim(*words, env={"YAMSIM_ABC": str(checkout / "assets")})
    assert run.code == 4
    assert run.message.startswith(f"YAMSIM_ABC: there is no folder {checkout / 'assets' / 'assets' / 'put_bottles'}")


@pytest.mark.parametrize(
    "flags",
    [
        ("--rig", "single"),
        ("--scene", "kitchen"),
        ("--grasp", "contact"),
        ("--object", "banana"),
        ("--threshold", "0.1"),
        ("--randomize",),
        ("--quality", "fast"),
        ("--end", "actor"),
        ("--config", "other"),
        ("--trained-on", "dataset"),
        ("--video", "films"),
    ],
    ids=lambda flags: flags[0],
)
def test_flags_of_other_scenes_are_refused(flags: tuple[str, ...]) -> None:
    run = yamsim(*EVAL, "--policy", "scripted", "--n", "1", *flags, env={"YAMSIM_ABC": ""})
    assert run.code == 2
    expected = (
        f"{flags[0]} is not for --task abc/put_bottles, whose scene, starts and success rule are fixed: leave it out"
    )
    assert run.message == expected


def test_other_commands_refuse_the_task() -> None:
    run = yamsim("trials", "--task", "abc/put_bottles", "--n", "1")
    assert run.code == 2
    assert run.message.startswith("task abc/put_bottles: only `yamsim eval` runs it")


def test_a_short_run_gives_the_report(checkout: Path, tmp_path: Path) -> None:
    flags = ("--policy", "policies.py:Turning", "--n", "2", "--time-limit", "1", "--seed", "7")
    run = evaluate(checkout, *flags, "--out", tmp_path / "report.json", "--json")
    assert run.code == 0, run.err
    report = run.json
    assert json.loads((tmp_path / "report.json").read_text()) == report
    assert "this must not get into the report" in run.err
    shared = ("policy", "task", "rig", "arms", "seed", "grasp", "end_rule", "tick_s")
    assert [report[key] for key in shared] == [
        "policies.py:Turning", "abc/put_bottles", "abc_put_bottles", ["left", "right"], 7, "contact", "success", 0.034,
    ]  # fmt: skip
    settings = report["settings"]
    assert (settings["engine"], settings["size_px"]) == (f"MuJoCo {mujoco.__version__}", [224, 168])
    assert [trial["start_seed"] for trial in report["trials"]] == [7, 8]
    for trial in report["trials"]:
        # 29 actions of 34 ms are within a second.
        assert (trial["ended"], trial["actions"], trial["simulated_s"]) == ("time_limit", 29, 0.986)
        assert (trial["in_bin"], trial["most_in_bin"], trial["error"]) == ([], 0, None)
        assert (trial["outcome"]["success"], trial["outcome"]["cause"]) == (False, "bottles_left")
        assert set(trial["layout"]) == {*(f"bottle_{k}" for k in range(1, 7)), "bin"}
    stats = report["stats"]
    assert (stats["n"], stats["n_success"], stats["success_rate"]) == (2, 0, 0.0)
    assert (stats["ended"], stats["causes"]) == ({"time_limit": 2}, {"bottles_left": 2})
    assert (stats["mean_bottles_in_bin"], stats["mean_most_bottles_in_bin"]) == (0.0, 0.0)
    assert stats["chunks"]["actions"] == 2 * 60


def test_the_default_seed_the_table_and_a_required_share_of_successes(checkout: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.json"
    flags = ("--policy", "policies.py:Turning", "--n", "1", "--time-limit", "0.1", "--min-success", "0.5")
    run = evaluate(checkout, *flags, "--out", out)
    assert run.code == 5, run.err
    assert run.err.splitlines()[-1].endswith("--min-success requires 0.5")
    assert "0 of 1" in run.out
    assert "at most 0.00, and 0.00 at the end" in " ".join(run.out.split())
    assert json.loads(out.read_text())["trials"][0]["start_seed"] == SEED


def test_a_policy_whose_trials_do_not_run_is_no_result(checkout: Path) -> None:
    run = evaluate(checkout, "--policy", "policies.py:Failing", "--n", "1", "--json")
    assert run.code == 6
    assert run.json["stats"]["causes"] == {"policy_raised": 1}
    assert "KeyError: 'no such thing'" in run.err.splitlines()[-1]


@pytest.mark.slow
def test_policies_and_reports_are_compared_on_the_same_starts(checkout: Path, tmp_path: Path) -> None:
    common = ("--n", "2", "--time-limit", "0.2", "--json")
    old = evaluate(checkout, "--policy", "policies.py:Turning", *common, "--out", tmp_path / "old.json")
    assert old.code == 0, old.err
    run = evaluate(
        checkout, "--policy", "hold_still", "--compare", "old.json", "--compare", "policies.py:Failing",
        "--html", tmp_path / "page.html", *common,
    )  # fmt: skip
    assert run.code == 0, run.err
    assert [pair["policy"] for pair in run.json["compared"]] == ["policies.py:Turning", "policies.py:Failing"]
    assert {(pair["n"], pair["neither"]) for pair in run.json["compared"]} == {(2, 2)}
    assert "Leaderboard" in (tmp_path / "page.html").read_text()
    other = evaluate(checkout, "--policy", "hold_still", "--compare", "old.json", "--seed", "1", *common)
    assert other.code == 2
    assert other.message.endswith(f"its seed is {SEED}, not 1: trials cannot be paired")
