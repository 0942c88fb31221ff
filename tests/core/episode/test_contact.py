"""Attempts with grasps by friction: they hold, report slips, and repeat."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.attempts import all_actions, planned
from tests.cli.run_cli import yamsim
from tests.unrendered import SIZE, write_dataset
from yamsim_cli.core.attempt_data import ActionSequence, Attempt, FailureCause, JointPath
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episode, read_recording_config
from yamsim_cli.core.episode.commands import path_actions
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import simulate_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.datasets.verify import ACTIONS, SEED, EpisodeVerifier, Tolerances

HELD_SLIP = 0.0075  # m, how far a thing that a hand holds may move in it

FRICTION = {("rig",): "single_linear", ("grasp",): "contact", ("image", "size_px"): SIZE, ("seed",): 5}


# Attempt and actions.
Succeeded = tuple[Attempt, ActionSequence]


@pytest.fixture(scope="module")
def friction(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config(FRICTION)


@pytest.fixture(scope="module")
def simulator(friction: RecordConfig, locations: Locations) -> Simulator:
    return Simulator(Session(friction, locations))


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory, friction: RecordConfig, locations: Locations) -> Path:
    path = tmp_path_factory.mktemp("contact") / "dataset"
    write_dataset(path, friction, locations, 2)
    return path


@pytest.fixture(scope="module")
def succeeded(simulator: Simulator) -> Succeeded:
    """Return a successful attempt and its actions."""
    done = planned(simulator, 5)
    assert done.outcome.success
    return done.attempt, all_actions(done.recorded_states)


@pytest.mark.slow
def test_friction_alone_holds_the_object(simulator: Simulator) -> None:
    for number in range(6):
        done = planned(simulator, 11, number)
        outcome = done.outcome
        assert outcome.success, outcome
        assert outcome.dxy is not None
        assert outcome.dxy < 0.01
        assert not all_actions(done.recorded_states).magnet.any()
        margins = outcome.margins
        assert margins is not None and margins.slip is not None and margins.tilt is not None
        assert 0 < margins.slip < HELD_SLIP
        # Level while it is carried.
        assert np.degrees(margins.tilt) < 3
        assert margins.velocity < 1
        assert margins.torque < 0.8
        assert margins.joint > 0.1


def test_no_two_frames_are_the_same(original: Path) -> None:
    """From each frame to the next, arm, fingers or object move."""
    frames = open_episode(original / "ep_000000").frames()
    positions = np.array([frame["sim_qpos"] for frame in frames])
    arm_and_fingers = np.abs(np.diff(positions[:, :8], axis=0)).max(axis=1)
    assert arm_and_fingers.min() > 1e-5
    # Joint speeds change steadily: between two frames by less than a motor's maximum speed.
    speeds = np.diff(positions[:, :6], axis=0) / 0.064
    assert (np.abs(np.diff(speeds, axis=0)).max(axis=0) < (5, 5, 5, 10, 10, 10)).all()


def _rerun(simulator: Simulator, attempt: Attempt, actions: ActionSequence) -> tuple[FailureCause | None, str]:
    outcome = simulate_actions(simulator, attempt, actions, EXPERT_RULES).outcome
    return outcome.cause, outcome.detail


def test_fingers_that_open_on_the_way_drop_it(simulator: Simulator, succeeded: Succeeded) -> None:
    attempt, acting = succeeded
    ctrl = acting.ctrl.copy()
    closed = np.flatnonzero(ctrl[:, 6] < ctrl[0, 6] - 0.005)
    # Lifted, and not yet over the plate.
    ctrl[closed[len(closed) // 3] :, 6] = 0.04
    assert _rerun(simulator, attempt, replace(acting, ctrl=ctrl)) == (
        FailureCause.GOAL, "on(banana, plate): they do not touch"
    )  # fmt: skip


def test_a_slippery_object_slips(friction: RecordConfig, locations: Locations, succeeded: Succeeded) -> None:
    slippery = Simulator(Session(friction, locations))
    slippery.scene.model.geom_friction[:] = 0.02
    outcome = simulate_actions(slippery, *succeeded, EXPERT_RULES).outcome
    assert outcome.cause is FailureCause.GOAL
    assert outcome.margins is not None and outcome.margins.slip is not None
    assert outcome.margins.slip > HELD_SLIP


def test_a_hand_that_comes_down_beside_it_knocks_it_away(simulator: Simulator, succeeded: Succeeded) -> None:
    attempt, acting = succeeded
    address = simulator.scene.object_qpos["banana"]
    assert attempt.start is not None
    moved = attempt.start.copy()
    moved[address : address + 2] += (0.02, 0.02)
    assert _rerun(simulator, replace(attempt, start=moved), acting)[0] is FailureCause.GOAL


def test_an_arm_that_touches_the_table_fails_whatever_becomes_of_the_object(
    simulator: Simulator, succeeded: Succeeded
) -> None:
    attempt, acting = succeeded
    # Once the banana lies on the plate, the hand turns away, and the shoulder bends until the fingers are on the table.
    turn, bow = 40, 40
    begin, ticks = len(acting.ctrl) + turn, turn + bow
    longer = [
        np.concatenate([rows, rows[-1:].repeat(ticks, axis=0)]) for rows in (acting.ctrl, acting.magnet, acting.joints)
    ]
    ctrl = longer[0]
    ctrl[-ticks:, 0] += np.minimum(np.arange(ticks) / turn, 1.0) * 0.8
    ctrl[-bow:, 1] += np.linspace(0, 1.5, bow)
    cause, detail = _rerun(simulator, attempt, ActionSequence(*longer))
    assert cause is FailureCause.COLLIDED
    assert "finger" in detail
    assert "table" in detail
    (seconds,) = re.findall(r"touch after (\S+) s$", detail)
    assert begin * 0.032 < float(seconds) < len(ctrl) * 0.032


def test_a_joint_that_is_driven_too_hard_fails(simulator: Simulator, succeeded: Succeeded) -> None:
    attempt, acting = succeeded
    ctrl = acting.ctrl.copy()
    ctrl[-20:, 0] += 2.0
    cause, detail = _rerun(simulator, attempt, replace(acting, ctrl=ctrl))
    assert cause is FailureCause.LIMITS
    assert "of its motor's speed" in detail


@pytest.mark.slow
def test_an_episode_is_made_again_bit_for_bit(original: Path, locations: Locations) -> None:
    config = read_recording_config(original, locations)
    verifier = EpisodeVerifier(Session(config, locations), Tolerances(values=0.0, images=None))
    for number in range(2):
        verdict = verifier.run((number, original / f"ep_{number:06d}"))
        assert verdict.is_reproduced
        assert set(verdict.checks) == {SEED, ACTIONS}
        assert all(check.max_error == 0.0 for check in verdict.checks.values())


@pytest.mark.slow
def test_a_record_has_the_grasp(original: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(original, tmp_path / "dataset")
    run = yamsim("summarize", copy, "--json")
    # The images are fake, and there is neither ledger nor manifest.
    codes = {problem["code"] for problem in run.json["problems"] if problem["severity"] == "error"}
    assert codes <= {"ledger.missing", "image.frozen"}
    assert run.json["grasps"] == ["contact"]
    assert run.json["frames"] == sum(open_episode(copy / f"ep_{k:06d}").record.frames for k in range(2))
    assert run.json["success_rate"]["0.05"] == 1.0


def test_a_gripper_without_pads_is_refused_with_the_rig_to_use(locations: Locations) -> None:
    overrides = {("grasp",): ("test", "contact")}
    wanted = r"'contact' needs a gripper with pads.*rig 'single' has crank; use --rig single_linear"
    with pytest.raises(ConfigError, match=wanted):
        load_config(RecordConfig, "record", "default", locations, overrides)
    run = yamsim("pickplace", "batch", "--grasp", "contact", "--n", "1")
    assert run.code == 2
    assert "single_linear" in run.message


def test_the_drive_is_told_to_close_further_than_the_object_lets_it(simulator: Simulator) -> None:
    scene = simulator.scene
    n = 3
    path = JointPath(
        joints=np.zeros((n + 1, 6)),
        torques=np.zeros((n, 6)),
        gripper=np.full(n, 0.018),
        grip_force=np.array([0.0, 15.0, 1000.0]),
        weld_on=(False,) * n,
        tick=0.032,
    )
    # 2 x 15 N over 2000 N/m, clipped to the drive's range.
    np.testing.assert_allclose(path_actions(scene, [path]).ctrl[:, 6], (0.018, 0.003, -0.005))


@pytest.mark.slow
def test_the_command_counts_and_reports(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    batch = ("pickplace", "batch", "--n", "3", "--seed", "4", "--grasp", "contact", "--rig", "single_linear")
    run = yamsim(*batch, "--workers", "2", "--html", page, "--json")
    assert run.code == 0, run.err
    report = run.json
    assert (report["n_success"], report["grasp"], report["rig"]) == (3, "contact", "single_linear")
    trials = [trial["outcome"]["margins"] for trial in report["trials"]]
    for key, worst in (("velocity_share", max), ("torque_share", max), ("joint_rad", min), ("slip_m", max)):
        assert report["margins"][key] == worst(trial[key] for trial in trials)
    assert "grasp contact" in page.read_text()
    alone = yamsim(*batch, "--workers", "1", "--json").json
    assert alone["trials"] == report["trials"]
    again = yamsim(*batch, "--html", page)
    assert (again.code, "--overwrite" in again.message) == (2, True)
