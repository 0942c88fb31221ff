"""Demonstrations with noise, pushes and late grasps: the expert recovers, and the seed reproduces them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yamsim_cli.api import API_SESSION_OPENER
from yamsim_cli.core.attempt_data import ActionSequence, AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import (
    SimulatedAttempt,
    simulate_actions,
    simulate_expert,
    with_reserved_distractors,
)
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.datasets.verify import ACTIONS, SEED, EpisodeVerifier, Tolerances
from yamsim_cli.disturbances.config import DisturbanceConfig
from yamsim_cli.disturbed_motion import sample_pushes
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import inline_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput

JOB = AttemptJob(303, 2)
NONE = {"noise_rad": 0.0, "push_probability": 0.0, "late_grasp_probability": 0.0}
PUSH = NONE | {"push_probability": 1.0, "push_mps": [0.8, 0.8], "push_time_s": [1.0, 1.0]}
LATE = NONE | {"late_grasp_probability": 1.0, "late_grasp_s": [0.8, 0.8]}
NOISE = NONE | {"noise_rad": 0.003}

Demonstrate = Callable[[dict[str, Any] | None], SimulatedAttempt]


@pytest.fixture(scope="module")
def simulator(make_config: Callable[..., RecordConfig], locations: Locations) -> Simulator:
    return Simulator(Session(make_config(), locations).without_meshes())


@pytest.fixture(scope="module")
def demonstrate(simulator: Simulator) -> Demonstrate:
    """Return a function that simulates the attempt `JOB` with the disturbances of a config."""

    def run(given: dict[str, Any] | None) -> SimulatedAttempt:
        disturb = None if given is None else DisturbanceConfig.model_validate(given)
        simulator.config = simulator.config.model_copy(update={"disturb": disturb})
        return simulate_expert(simulator, sample_attempt(simulator, JOB))

    return run


def executed(done: SimulatedAttempt) -> ActionSequence:
    parts = [state.actions for state in done.recorded_states]
    return ActionSequence(*(np.concatenate([getattr(p, key) for p in parts]) for key in ("ctrl", "magnet", "joints")))


def intended(done: SimulatedAttempt) -> np.ndarray[Any, Any]:
    return np.array([state.intended for state in done.recorded_states])


def first_rows(done: SimulatedAttempt) -> np.ndarray[Any, Any]:
    return np.array([state.actions.ctrl[0] for state in done.recorded_states])


def test_a_config_that_disturbs_nothing_changes_nothing(demonstrate: Demonstrate) -> None:
    plain, disturbed = demonstrate(None), demonstrate(NONE)
    assert plain.outcome.success and plain.outcome == disturbed.outcome
    assert np.array_equal(executed(plain).ctrl, executed(disturbed).ctrl)
    assert all(state.intended is None for state in plain.recorded_states)
    assert np.array_equal(intended(disturbed), first_rows(plain))


def test_the_expert_follows_a_pushed_object_and_the_actions_repeat_the_push(
    simulator: Simulator, demonstrate: Demonstrate
) -> None:
    done = demonstrate(PUSH)
    (push,) = done.attempt.variation.pushes
    assert np.linalg.norm(push.velocity) == pytest.approx(0.8)
    assert done.outcome.success
    assert [each.skill for each in done.outcome.recoveries] == ["pick"]
    assert "was pushed and has moved" in done.outcome.recoveries[0].detail

    def final(attempt: SimulatedAttempt) -> np.ndarray[Any, Any]:
        return attempt.recorded_states[-1].qpos

    assert np.array_equal(final(simulate_actions(simulator, done.attempt, executed(done), EXPERT_RULES)), final(done))
    unpushed = replace(done.attempt, variation=replace(done.attempt.variation, pushes=()))
    assert not np.array_equal(final(simulate_actions(simulator, unpushed, executed(done), EXPERT_RULES)), final(done))


def test_a_late_grasp_misses_the_object_and_is_tried_again(demonstrate: Demonstrate) -> None:
    done = demonstrate(LATE)
    assert done.outcome.success
    assert [each.skill for each in done.outcome.recoveries] == ["pick"]


def test_noise_acts_on_the_drives_and_not_on_the_recorded_action(
    simulator: Simulator, demonstrate: Demonstrate
) -> None:
    done = demonstrate(NOISE)
    assert done.outcome.success
    arm = simulator.scene.arms[0].arm_ctrl
    noise = (first_rows(done) - intended(done))[:, arm]
    assert 0.001 < noise.std() < 0.006
    fingers = simulator.scene.arms[0].fingers
    assert fingers is not None
    assert np.array_equal(first_rows(done)[:, fingers.ctrl], intended(done)[:, fingers.ctrl])


def test_other_actors_are_not_disturbed(simulator: Simulator) -> None:
    disturb = DisturbanceConfig.model_validate(PUSH)
    simulator.config = simulator.config.model_copy(update={"disturb": disturb})
    attempt = sample_attempt(simulator, JOB)
    assert with_reserved_distractors(simulator, attempt).variation.pushes == ()
    assert simulate_expert(simulator, attempt, disturbed=False).outcome.recoveries == ()


def test_pushes_follow_the_config_and_the_seed() -> None:
    config = DisturbanceConfig(push_probability=0.5, push_mps=(0.2, 0.4), push_time_s=(1.0, 2.0))
    drawn = [sample_pushes(config, AttemptJob(1, k), ("cup", "can"), 0.032) for k in range(200)]
    assert drawn == [sample_pushes(config, AttemptJob(1, k), ("cup", "can"), 0.032) for k in range(200)]
    pushes = [push for each in drawn for push in each]
    assert 70 < len(pushes) < 130
    assert {push.thing for push in pushes} == {"cup", "can"}
    assert all(0.2 <= np.linalg.norm(push.velocity) <= 0.4 and push.velocity[2] == 0 for push in pushes)
    assert all(31 <= push.tick <= 63 for push in pushes)
    assert (
        sample_pushes(config, AttemptJob(1, 0), (), 0.032) == sample_pushes(None, AttemptJob(1, 0), ("cup",), 1) == ()
    )


def test_the_flag_uses_the_ranges_of_the_config(tmp_path: Path, locations: Locations) -> None:
    def disturb_of(given: str, **settings: Any) -> DisturbanceConfig | None:
        file = tmp_path / "own.yaml"
        file.write_text((locations.config_file("record", "default")).read_text(encoding="utf-8") + given)
        return API_SESSION_OPENER.load_record_config(str(file), locations, **settings).disturb

    assert disturb_of("", disturb=True) == DisturbanceConfig()
    assert disturb_of("disturb: {noise_rad: 0.002}\n", disturb=True) == DisturbanceConfig(noise_rad=0.002)
    with pytest.raises(ConfigError, match=r"noise_rad.*0\.\.0\.1 rad; is it in degrees"):
        disturb_of("disturb: {noise_rad: 0.3}\n")


def test_a_disturbed_recording_is_reproduced_from_its_seed_and_from_its_actions(tmp_path: Path) -> None:
    given = NOISE | {key: PUSH[key] for key in ("push_probability", "push_mps", "push_time_s")}
    session = API_SESSION_OPENER.open("default", renders=False, n=1, seed=303, camera=(), disturb=True)
    disturb = DisturbanceConfig.model_validate(given)
    session = session.with_values(disturb=disturb, cameras=())
    output = RecordingOutput(out := tmp_path / "dataset", ExistingDatasetMode.NEW)
    callbacks = RecordCallbacks(lambda *_: None, lambda text: None)
    record(session, output, inline_executor, callbacks, StopRequest())
    episode = open_episode(out / "ep_000000")
    assert len(episode.record.randomized.pushes) == 1
    frame = episode.frames()[5]
    assert not np.allclose(frame["ctrl"], frame["sim_ctrl"][0], atol=1e-6)
    with EpisodeVerifier(session, Tolerances(0.0, None)) as verifier:
        verdict = verifier.run((0, out / "ep_000000"))
    assert verdict.is_reproduced and set(verdict.checks) == {SEED, ACTIONS}
