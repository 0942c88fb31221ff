"""`yamsim eval` and `serve-policy` as a user runs them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim

SAMPLES = Path(__file__).parents[1] / "core" / "policies" / "sample_policies.py"


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
    assert run.code == 0, run.err
    for text in ("0 of 2 (0.0%; 95 % interval 0.0% to", "failed: policy_raised", "KeyError: 'no such thing'"):
        assert text in run.out


@pytest.mark.parametrize(
    ("flags", "code", "told"),
    [
        (("--policy", "nothing"), 2, "give scripted, hold_still, replay:DATASET"),
        (("--policy", "scripted", "--task", "handover"), 2, "--task: task 'handover' needs two arms"),
        (("--policy", "scripted", "--overwrite"), 2, "give --video"),
        (("--policy", "http://127.0.0.1:9"), 4, "no policy answers there"),
        (("--policy", "replay:nowhere"), 2, "there are no episodes"),
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
        assert sum(1 for _ in container.decode(video=0)) == 57


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
