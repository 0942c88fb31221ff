"""`yamsim gap`: one log, several logs, recordings with photos, and refused input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.real.recordings.making import write_csv
from tests.rig_scenes import later, plant, rig_scene, swings
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion

TIMES = np.arange(0, 3.0, 0.01)


@pytest.fixture(scope="module")
def single(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "single", locations)


@pytest.fixture(scope="module")
def made() -> RecordedMotion:
    return plant(rig_scene(), TIMES, [swings(TIMES)])


@pytest.fixture(scope="module")
def logs(single: RigConfig, made: RecordedMotion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("my logs")
    for name, motion in (("perfect", made), ("late", later(made, 2)), ("later", later(made, 3))):
        write_csv(folder / f"{name}.csv", motion, single)
    return folder


def test_a_log_of_a_perfect_model_passes(logs: Path) -> None:
    run = yamsim("gap", logs / "perfect.csv", "--rig", "single", "--fail-above", "0.1", "--json")
    assert run.code == 0, run.err
    assert run.err == ""
    report = run.json
    assert report["rig"] == "single" and report["rms_rad"] < 1e-4 and report["max_rad"] < 1e-4
    assert {"name", "arm", "rms_rad", "p95_rad", "max_rad", "delay_s", "sag_rad", "overshoot_rad"} <= set(
        report["joints"][1]
    )
    assert {"recording", "frame", "time_s", "joint", "error_rad"} <= set(report["worst"])
    assert report["hands"][0]["rms_mm"] < 0.1 and report["problems"] == []


def test_a_gap_above_the_limit_fails_with_a_whole_report(logs: Path, tmp_path: Path) -> None:
    page, file = tmp_path / "gap.html", tmp_path / "gap.json"
    logs_of = [logs / "late.csv", logs / "later.csv"]
    run = yamsim("gap", *logs_of, "--fail-above", "2.5", "--html", page, "--out", file, "--json")
    assert run.code == 5
    assert run.err.splitlines()[-1].startswith("yamsim: the error of joint")
    assert "--fail-above" in run.err and "2.5" in run.err
    report = run.json
    assert len(report["recordings"]) == 2 and file.is_file() and page.read_text().endswith("</html>\n")
    assert report["joints"][0]["delay_s"] == pytest.approx(0.025, abs=0.002)
    assert report["joints"][0]["intervals"]["delay_s"][0] < 0.025
    told = yamsim("gap", *logs_of)
    assert told.code == 0
    assert "joint3" in told.out and "by recording" in told.out.lower() and "delay ms" in told.out


def test_a_part_is_compared(logs: Path) -> None:
    whole, part = (yamsim("gap", logs / "late.csv", "--json", *flags).json for flags in ((), ("--to", "0.4")))
    # The arm stands still at first.
    assert whole["rms_rad"] > 1e-3 > 1e-4 > part["rms_rad"]


def test_what_looks_wrong_with_a_recording_is_told(single: RigConfig, made: RecordedMotion, tmp_path: Path) -> None:
    (arm,) = made.arms
    assert arm.openings is not None and arm.commanded_openings is not None
    shares = replace(arm, openings=20 * arm.openings, commanded_openings=20 * arm.commanded_openings)
    path = write_csv(tmp_path / "shares.csv", replace(made, arms=(shares,)), single)
    run = yamsim("gap", path, "--json")
    assert run.code == 0
    assert "gripper is at" in run.err
    assert run.json["problems"][0]["fault"] == "gripper_share"


def test_other_units_are_refused_before_anything_is_simulated(
    single: RigConfig, made: RecordedMotion, tmp_path: Path
) -> None:
    (arm,) = made.arms
    assert arm.commands is not None
    late = replace(made, times=made.times * 1000)
    told = replace(made, arms=(replace(arm, commands=np.degrees(arm.commands)),))
    turned = replace(made, arms=(replace(arm, joints=np.degrees(arm.joints)),))
    for name, motion, said in (("ms", late, "is it in ms"), ("told", told, "degrees"), ("turned", turned, "degrees")):
        run = yamsim("gap", write_csv(tmp_path / f"{name}.csv", motion, single))
        assert run.code == 4
        assert said in run.message


def test_what_was_imported_has_the_gap_that_it_had_before(logs: Path, tmp_path: Path) -> None:
    real = tmp_path / "real"
    assert yamsim("import", logs / "late.csv", "--rig", "single", "--out", real).code == 0
    # The command uses the dataset's rig.
    before, after, one = (yamsim("gap", path, "--json").json for path in (logs / "late.csv", real, real / "ep_000000"))
    assert after["rms_rad"] == pytest.approx(before["rms_rad"], rel=1e-4)
    assert one["recordings"][0]["rms_rad"] == after["rms_rad"]
    assert "need --rig" in yamsim("gap", real, "--revision", "v1").message


def test_a_missing_recording_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("none", "empty", "none.csv"):
        run = yamsim("gap", tmp_path / name)
        assert run.code == 4 and str(tmp_path / name) in run.message


@pytest.mark.parametrize(
    ("flags", "code", "said"),
    [
        (("--from", "2", "--to", "1"), 2, "--from 2 and --to 1: --from must be below --to"),
        (("--from", "50"), 4, "0 measured samples from 50 s"),
        (("--camera", "camera.yaml"), 2, "give --pictures N with them"),
        (("--pictures", "3"), 2, "--pictures"),
        (("--html", "."), 2, "is a directory"),
        (("--rig", "bimanual"), 4, "has no column 'position_left_joint1'"),
        (("--rig", "nowhere"), 3, "nowhere"),
        (("--fail-above", "-1"), 2, "--fail-above"),
    ],
)
def test_contradicting_flags_of_gap_are_refused_in_one_line(
    logs: Path, flags: tuple[str, ...], code: int, said: str
) -> None:
    run = yamsim("gap", logs / "perfect.csv", *flags)
    assert (run.code, run.out) == (code, "")
    assert said in run.message


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda text: text.replace(text.splitlines()[40].split(",")[3], "nan", 1), "nan"),
        (lambda text: "\n".join(text.splitlines()[:6]) + "\n", "5 measured samples"),
        (lambda text: text.replace("command_", "asked_"), "no commands"),
    ],
)
def test_a_spoilt_log_is_one_line_that_names_it(logs: Path, tmp_path: Path, spoil: object, said: str) -> None:
    path = tmp_path / "spoilt.csv"
    path.write_text(spoil((logs / "perfect.csv").read_text()))  # type: ignore[operator]
    run = yamsim("gap", path)
    assert (run.code, run.out) == (4, "")
    assert str(path) in run.message and said in run.message
