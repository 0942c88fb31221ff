"""Teleoperated program tasks: casts, goals, and effects of a stop on held objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.attempts import all_actions
from tests.cli.run_cli import yamsim
from tests.programs import ONTO_PLATE, changed, first_attempt, session_of, written
from tests.viewers.teleop.demonstrated import write_stream
from tests.viewers.teleop.test_teleop import play
from tests.viewers.teleop.tray import CollectingReceiver
from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode_rules import EndRule
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.errors import ConfigError, SimulationError
from yamsim_cli.viewers.teleop.command_stream import read_stream
from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene

TICK = 0.032


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return session_of(tmp_path_factory.mktemp("task"), ONTO_PLATE)


@pytest.fixture(scope="module")
def lines(session: Session) -> list[dict[str, Any]]:
    """The expert's first attempt as a leader arm would send it, at half its speed."""
    with SimulatorCache(session) as simulators:
        simulator, attempt = first_attempt(simulators)
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success
        actions, fingers = all_actions(done.recorded_states), simulator.scene.first_arm.fingers
    assert fingers is not None
    said: list[dict[str, Any]] = [{"t": 0.0, "event": "start"}]
    for k, (asked, ctrl) in enumerate(zip(actions.joints[:, 0], actions.ctrl, strict=True)):
        opening = max(0.0, float(ctrl[fingers.ctrl]))
        said.append({"t": round(2 * k * TICK, 6), "joints": asked[:-1].tolist(), "gripper": opening})
    return [*said, {"t": round((2 * len(actions.ctrl) + 15) * TICK, 6), "event": "stop"}]


@pytest.mark.slow
def test_a_stream_that_reaches_the_goal_is_a_success(
    session: Session, lines: list[dict[str, Any]], tmp_path: Path
) -> None:
    tray = CollectingReceiver()
    driven = TeleopScene(session, tray)
    assert driven.status.goal.startswith("not yet: on(cube, plate)") and driven.status.magnet is None
    said = driven.status.prompt
    assert said in ONTO_PLATE["phrasings"]["training"]
    play(driven, lines, tmp_path)
    driven.settle()
    (submitted,) = tray.attempts
    assert submitted.outcome.success, submitted.outcome
    assert [measure.what for measure in submitted.outcome.measures] == ["on(cube, plate)"]
    assert submitted.attempt.phrasing == said


@pytest.mark.slow
def test_what_is_not_recorded_goes_on_once_the_goal_holds(
    session: Session, lines: list[dict[str, Any]], tmp_path: Path
) -> None:
    driven = TeleopScene(session, CollectingReceiver(), end=EndRule.SUCCESS)
    play(driven, [line for line in lines if "event" not in line], tmp_path)
    for _ in range(20):
        driven.advance_tick()
    assert driven.status.goal == "the goal holds"
    joints = driven.data.qpos[:6].copy()
    driven.set_joint_target(joints + 0.2)
    for _ in range(20):
        driven.advance_tick()
    assert np.abs(driven.data.qpos[:6] - joints).max() > 0.1


def test_attempts_have_casts_and_scenes_of_their_own(session: Session) -> None:
    tray = CollectingReceiver()
    driven = TeleopScene(session, tray)
    models, kinds = {id(driven.model): driven.model}, set[str]()
    for _ in range(4):
        driven.start_recording()
        driven.advance_tick()
        driven.stop_recording()
        driven.settle()
        models[id(driven.model)] = driven.model
    for submitted in tray.attempts:
        assert submitted.attempt.roles is not None
        kinds.add(submitted.attempt.roles.config_names["cube"])
    assert kinds == {"cube_red", "cube_blue"} and len(models) == 2
    assert {submitted.outcome.cause for submitted in tray.attempts} == {FailureCause.GOAL}


def test_a_stop_lets_nothing_go_and_waits_as_long_as_the_goal_has_to_hold(session: Session) -> None:
    tray = CollectingReceiver()
    driven = TeleopScene(session, tray)
    driven.start_recording()
    driven.set_gripper(0.01)
    for _ in range(20):
        driven.advance_tick()
    driven.stop_recording()
    driven.settle()
    actions, task = tray.actions, session.config.task
    assert np.allclose(actions.joints[-1, 0, -1], 0.01)
    assert len(actions.ctrl) == 20 + task.timing.settle_ticks + task.hold_ticks


def test_a_magnet_command_without_welds_is_refused(session: Session, tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "stream.jsonl", [{"t": 0, "magnet": True}])
    with pytest.raises(ConfigError, match=r"stream.jsonl:1: magnet: task 'small' with grasp 'contact' has none"):
        read_stream(stream, session.config)


def test_objects_without_room_are_refused(tmp_path: Path) -> None:
    tight = changed({("starts", "cube", "x"): [0.40, 0.40], ("starts", "cube", "y"): [-0.15, -0.15]})
    with pytest.raises(SimulationError, match="task 'small': no free place for the cube in its start region"):
        TeleopScene(session_of(tmp_path, tight), CollectingReceiver())


@pytest.mark.slow
@pytest.mark.render
def test_what_was_driven_is_recorded_and_verified(lines: list[dict[str, Any]], tmp_path: Path) -> None:
    task, out = written(tmp_path, ONTO_PLATE), tmp_path / "driven"
    stream = write_stream(tmp_path / "stream.jsonl", lines)
    run = yamsim("teleop", "--input", stream, "--task", task, "--size", "64x48", "--out", out, "--json")
    assert run.code == 0 and run.json["episodes"] == 1, run.err
    assert run.json["trials"][0]["measures"][0]["what"] == "on(cube, plate)"
    run = yamsim("verify", out, "--tolerance", "0", "--json")
    assert run.code == 0, run.err
