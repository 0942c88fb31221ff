"""`yamsim eval` and `serve-policy` as a user runs them."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim

SAMPLES = Path(__file__).parents[1] / "policies" / "sample_policies.py"


@pytest.mark.slow
def test_a_policy_in_a_file_is_counted_and_its_prints_stay_out_of_the_report(tmp_path: Path) -> None:
    run = yamsim(
        "eval", "--policy", f"{SAMPLES}:Faulty", "--n", "5", "--workers", "2", "--policy-timeout", "1",
        "--out", tmp_path / "report.json", "--json",
    )  # fmt: skip
    assert run.code == 0, run.err
    report = run.json
    assert [trial["ended"] for trial in report["trials"]] == [
        "policy_raised", "policy_invalid", "policy_invalid", "policy_slow", "done",
    ]  # fmt: skip
    assert (report["stats"]["n"], report["stats"]["n_success"], report["stats"]["success_rate"]) == (5, 0, 0.0)
    assert 0.4 < report["stats"]["wilson95"][1] < 0.5
    assert "this must not get into the report" in run.err
    assert json.loads((tmp_path / "report.json").read_text()) == report


def test_the_table_tells_rate_causes_and_errors() -> None:
    run = yamsim("eval", "--policy", f"{SAMPLES}:Faulty", "--n", "2", "--workers", "1")
    for text in ("0 of 2 (0.0%; 95 % interval 0.0% to", "failed: policy_raised", "KeyError: 'no such thing'"):
        assert text in run.out
    # The last line of the user's code, which the table folds.
    assert "sample_policies.py:" in "".join(run.out.split())
    assert "incall)" in "".join(run.out.replace("_", "").split())


def test_an_evaluation_in_which_no_trial_ran_is_no_success(tmp_path: Path) -> None:
    out = tmp_path / "report.json"
    run = yamsim("eval", "--policy", f"{SAMPLES}:Faulty", "--n", "3", "--workers", "1", "--out", out, "--json")
    assert run.code == 6
    # The whole report, and nothing else on stdout.
    assert run.json["stats"]["ended"] == {"policy_raised": 1, "policy_invalid": 2}
    assert json.loads(out.read_text()) == run.json
    first, second, _ = run.json["trials"]
    assert first["traceback"].startswith("Traceback (most recent call last):")
    assert first["traceback"].endswith("KeyError: 'no such thing'\n")
    assert second["traceback"] is None
    last = run.err.splitlines()[-1]
    assert "(policy_raised 1, policy_invalid 2)" in last and "trial 0: KeyError: 'no such" in last


@pytest.mark.parametrize(
    ("words", "count"),
    [
        pytest.param(
            ("pickplace", "batch", "--threshold", "0.0035", "--seed", "2", "--n", "4"), 4, marks=pytest.mark.slow
        ),
        (("eval", "--policy", "hold_still", "--time-limit", "0.1", "--n", "1"), 1),
    ],
)
def test_a_share_of_successes_can_be_asked_for(words: tuple[str, ...], count: int) -> None:
    run = yamsim(*words, "--workers", "1", "--min-success", "0.9", "--json")
    assert run.code == 5
    counts = run.json.get("stats", run.json)
    assert counts["success_rate"] < 0.9
    assert run.err.splitlines()[-1] == (
        f"yamsim: {counts['n_success']} of {count} trials succeeded, a share of {counts['success_rate']:g}; "
        "--min-success requires 0.9"
    )
    share = f"{counts['success_rate']}"
    assert yamsim(*words, "--workers", "1", "--min-success", share).code == 0


@pytest.mark.parametrize(
    ("flags", "code", "told"),
    [
        (("--policy", "nothing"), 2, "give scripted, hold_still, replay:DATASET"),
        (
            ("--policy", "scripted", "--task", "handover", "--rig", "single"),
            2,
            "--rig: the step `handover`",
        ),
        (("--policy", "scripted", "--video-all"), 2, "give --video"),
        (("--policy", "http://127.0.0.1:9"), 4, "http://127.0.0.1:9"),
        (("--policy", "replay:nowhere"), 2, "nowhere: "),
        (("--policy", "scripted", "--min-success", "90"), 2, "'--min-success'"),
        (("--policy", f"{SAMPLES}:Chunked", "--policy-arg", "speed=1"), 2, "unexpected keyword argument 'speed'"),
        ((), 2, "give --policy, or two reports of --out to compare: --compare A.json --compare B.json"),
        (("--policy", "hold_still", "--trained-on", "nowhere"), 2, "--trained-on nowhere: give a dataset of yamsim"),
        (("--policy", "hold_still", "--compare", "nowhere.json"), 2, "--compare nowhere.json: cannot be read"),
    ],
)
def test_what_cannot_be_run_is_one_line(flags: tuple[str, ...], code: int, told: str) -> None:
    run = yamsim("eval", "--n", "2", "--workers", "1", *flags)
    assert run.code == code
    assert told in run.err.splitlines()[-1]
    assert "Traceback" not in run.err


@pytest.mark.render
@pytest.mark.slow
def test_failures_are_filmed(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="yamsim[video] is not installed")
    run = yamsim(
        "eval", "--policy", "scripted", "--n", "6", "--seed", "2", "--threshold", "0.0035", "--size", "64x48",
        "--video", tmp_path / "films", "--json",
    )  # fmt: skip
    assert run.code == 0, run.err
    failed = [trial["trial"] for trial in run.json["trials"] if not trial["outcome"]["success"]]
    assert [film["trial"] for film in run.json["videos"]] == failed
    assert 0 < len(failed) < 6
    with av.open(run.json["videos"][0]["path"]) as container:
        frames = sum(1 for _ in container.decode(video=0))
    assert frames == math.ceil(run.json["trials"][failed[0]]["simulated_s"] / 0.064)


@pytest.mark.slow
def test_a_policy_is_served_until_a_signal_and_ends_with_0() -> None:
    pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
    process = subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", "serve-policy", "--policy", f"{SAMPLES}:Still", "--port", "0", "--json"],
        cwd=Path(__file__).parents[2],
        env=os.environ,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        said = "".join(process.stdout.readline() for _ in range(3))
        run = yamsim("eval", "--policy", json.loads(said)["url"], "--n", "2", "--time-limit", "0.2", "--json")
        assert (run.code, run.json["stats"]["ended"]) == (0, {"time_limit": 2}), run.err
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")


@pytest.mark.slow
def test_policies_are_compared_on_the_same_starts_and_ranked(tmp_path: Path) -> None:
    common = ("--n", "3", "--workers", "2", "--time-limit", "2")
    old = yamsim("eval", "--policy", "hold_still", *common, "--out", tmp_path / "old.json", "--json")
    assert old.code == 0, old.err
    chunked = f"{SAMPLES}:Chunked"
    run = yamsim(
        "eval", "--policy", chunked, "--policy-arg", "actions=8", "--policy-arg", "step=0.02", "--execute", "4",
        "--latency", "80ms", "--compare", tmp_path / "old.json", "--compare", f"{SAMPLES}:Still",
        "--html", tmp_path / "page.html", *common, "--json",
    )  # fmt: skip
    assert run.code == 0, run.err
    assert [pair["policy"] for pair in run.json["compared"]] == ["hold_still", f"{SAMPLES}:Still"]
    assert {(pair["n"], pair["neither"], pair["p_value"]) for pair in run.json["compared"]} == {(3, 3, 1.0)}
    assert run.json["stats"]["chunks"]["stale"] > 0
    page = (tmp_path / "page.html").read_text()
    assert page.count("hold_still") >= 2 and "Leaderboard" in page
