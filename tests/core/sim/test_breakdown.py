"""A breakdown of physics is a cause of failure, and MuJoCo's messages on it reach no terminal and no file."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest

from tests.attempts import planned
from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode_rules import EndReason
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.compilation import physics_failure, silence_mujoco_warnings

# Joints in degrees, past the check that refuses them: the arm starts many turns beyond its limits.
ABSURD = """
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.episode.runner import AttemptRunner
from yamsim_cli.core.episode.episode_rules import EndReason
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.attempt_data import AttemptJob
where = Locations.from_environment({})
config = load_config(RecordConfig, "record", "default", where)
task = config.task.model_copy(update={"start_joints": (0.0, 106.0, 109.0, -78.5, 0.0, 0.0)})
with AttemptRunner(Session(config, where).with_values(task=task), render=False) as runner:
    outcomes = [runner.run(AttemptJob(0, number)).outcome for number in (1, 3)]
for outcome in outcomes:
    print(outcome.cause, "|", outcome.detail)
"""


@pytest.mark.slow
def test_a_simulation_that_breaks_down_fails_for_that_and_writes_nothing(tmp_path: Path, repository: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", ABSURD],
        cwd=tmp_path,
        env={"PYTHONPATH": str(repository), "MUJOCO_GL": "disabled"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    assert (run.stderr, list(tmp_path.iterdir())) == ("", [])
    assert "unstable | physics broke down within 0.0" in run.stdout
    assert "s: Nan, Inf or huge value in Q" in run.stdout


def test_a_stable_attempt_reports_no_breakdown(config: RecordConfig, locations: Locations) -> None:
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, 0)
    assert done.outcome.cause is not FailureCause.UNSTABLE
    assert done.result is not None
    assert done.result.end.reason is EndReason.ACTOR


@pytest.fixture
def falling() -> tuple[mujoco.MjModel, mujoco.MjData]:
    body = '<body><freejoint/><geom size=".1" mass="1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    return model, mujoco.MjData(model)


def test_each_fatal_warning_is_told_in_mujocos_words(
    falling: tuple[mujoco.MjModel, mujoco.MjData], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    silence_mujoco_warnings()
    model, data = falling
    assert physics_failure(data) is None
    data.qvel[2] = 1e20
    mujoco.mj_step(model, data)
    assert physics_failure(data) == "Nan, Inf or huge value in QVEL at DOF 2"
    mujoco.mj_resetData(model, data)
    assert physics_failure(data) is None
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_listens_itself_goes_on_hearing(
    falling: tuple[mujoco.MjModel, mujoco.MjData], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[str] = []
    before = mujoco.get_mju_user_warning()
    hear: Callable[[str], None] = heard.append
    mujoco.set_mju_user_warning(hear)
    try:
        silence_mujoco_warnings()
        model, data = falling
        data.qvel[0] = 1e20
        mujoco.mj_step(model, data)
    finally:
        mujoco.set_mju_user_warning(before)
    assert len(heard) == 1
