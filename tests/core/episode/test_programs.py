"""Attempts of a program task: recorded and reproduced bit for bit, and judged by the goal alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.programs import ONTO_PLATE, STATION, changed, first_attempt, session_of
from yamsim_cli.core.attempt_data import ActionSequence, Attempt, AttemptJob, FailureCause
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.checks.context import find_episodes, read_context
from yamsim_cli.core.dataset.checks.problem import ProblemCollector
from yamsim_cli.core.dataset.reader import open_episode, read_recording_config
from yamsim_cli.core.dataset.records import RoleAssignmentRecord, to_json
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode import sampling
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import simulate_actions, simulate_expert
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.jpeg import JpegReader
from yamsim_cli.core.sim.settling import settle_objects
from yamsim_cli.core.sim.sim_world import SimWorld
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.datasets.checks.episode import check_episode
from yamsim_cli.datasets.verify import ACTIONS, IMAGES, SEED, EpisodeVerifier, Tolerances
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialRunner
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import inline_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return session_of(tmp_path_factory.mktemp("task"), ONTO_PLATE)


@pytest.fixture(scope="module")
def simulators(session: Session) -> Iterator[SimulatorCache]:
    with SimulatorCache(session) as made:
        yield made


def recorded(session: Session, out: Path) -> Path:
    watch = RecordCallbacks(lambda done, wanted, attempts: None, lambda text: None)
    record(session, RecordingOutput(out, ExistingDatasetMode.NEW), inline_executor, watch, StopRequest())
    return out


@pytest.fixture(scope="module")
def dataset(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(session, tmp_path_factory.mktemp("data") / "dataset")


@pytest.mark.slow
@pytest.mark.render
def test_what_was_recorded_is_made_again_bit_for_bit(dataset: Path, locations: Locations) -> None:
    session = Session(read_recording_config(dataset, locations), locations).without_meshes()
    with EpisodeVerifier(session, Tolerances(0.0, 0.0)) as verifier:
        verdict = verifier.run((0, dataset / "ep_000000"))
    assert verdict.is_reproduced, verdict
    assert set(verdict.checks) == {SEED, ACTIONS, IMAGES}
    assert all(check.max_error == 0 for check in verdict.checks.values())


@pytest.mark.render
def test_a_record_says_who_played_what_and_how_far_the_goal_was_from_failing(dataset: Path) -> None:
    episode = open_episode(dataset / "ep_000000")
    known = episode.record
    assert known.format_version == 4 and known.objects == ["plate", "cube"] and known.grasp == "contact"
    assert known.cast is not None and known.cast.kinds["cube"] in ("cube_red", "cube_blue")
    assert known.phrasing in ONTO_PLATE["phrasings"]["training"]
    (measure,) = known.outcome.measures
    assert measure.what == "on(cube, plate)" and measure.margin > 0.03 and measure.unit == "m"
    assert len(known.layout["cube"]) == 7
    frame = episode.frames()[0]
    assert frame["language_prompt"] == known.phrasing and frame["cube_pose"].shape == (4, 4)
    line = json.loads((dataset / "attempts.jsonl").read_text())
    assert line["cast"]["things"] == {"plate": ["plate"], "cube": ["cube"]} and line["phrasing"] == known.phrasing


@pytest.mark.render
def test_nothing_is_wrong_with_the_dataset(dataset: Path, locations: Locations) -> None:
    problems = ProblemCollector()
    (directory,), recorded = find_episodes(dataset)
    context = read_context(dataset, recorded, locations, problems)
    with JpegReader() as reader:
        facts = check_episode(directory, context, reader)
    assert not problems.all_problems() and not facts.problems
    assert context.judged_by_goal and facts.outcome is not None and facts.outcome.success


@pytest.mark.slow
def test_actions_in_one_piece_give_what_they_gave_in_many(simulators: SimulatorCache) -> None:
    simulator, attempt = first_attempt(simulators, 2)
    done = simulate_expert(simulator, attempt)
    assert done.outcome.success, done.outcome
    acted = [state.actions for state in done.recorded_states]
    whole = ActionSequence(
        *(np.concatenate([getattr(one, part) for one in acted]) for part in ("ctrl", "magnet", "joints"))
    )
    again = simulate_actions(simulator, attempt, whole, EXPERT_RULES)
    assert again.outcome == replace(done.outcome, recoveries=())
    assert all(np.array_equal(a.qpos, b.qpos) for a, b in zip(done.recorded_states, again.recorded_states, strict=True))


def test_fingers_that_never_close_reach_nothing(simulators: SimulatorCache) -> None:
    simulator, attempt = first_attempt(simulators)
    outcome = simulate_expert(simulator, attempt, grips=False).outcome
    assert not outcome.success and outcome.cause in (FailureCause.SLIPPED, FailureCause.DROPPED, FailureCause.GOAL)


def test_every_failed_try_for_an_object_out_of_reach_is_recorded(tmp_path: Path) -> None:
    away = changed({("starts", "cube"): {"x": [0.70, 0.72], "y": [0.30, 0.32]}})
    with SimulatorCache(session_of(tmp_path, away)) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert outcome.cause is FailureCause.UNREACHABLE
    assert [(one.step, one.skill, one.frame) for one in outcome.recoveries] == [(0, "pick", 0), (0, "pick", 0)]


def test_standing_still_reaches_nothing_and_what_is_said_reaches_the_policy(session: Session, tmp_path: Path) -> None:
    with TrialRunner(session, PolicyChoice("hold_still", tmp_path, time_limit=1.0)) as runner:
        result = runner.run(AttemptJob(0, 0))
    assert not result.outcome.success and result.outcome.cause == FailureCause.GOAL and result.ticks == 31
    assert [measure.what for measure in result.outcome.measures] == ["on(cube, plate)"]


def test_a_goal_that_holds_at_the_start_is_no_task(tmp_path: Path) -> None:
    met = changed({("goal",): {"on": {"thing": "cube", "surface": "table"}}})
    with SimulatorCache(session_of(tmp_path, met)) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert attempt.layout is None and outcome.cause is FailureCause.NO_LAYOUT
    assert "the goal holds already at the start, in each of 20 samples" in outcome.detail


def test_an_object_without_room_is_named(tmp_path: Path) -> None:
    tight = changed({("starts", "cube", "x"): [0.40, 0.40], ("starts", "cube", "y"): [-0.15, -0.15]})
    with SimulatorCache(session_of(tmp_path, tight)) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert outcome.detail == "no free place for the cube in its start region"


def test_a_program_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, changed({("time_limit_s",): 3.0}))) as simulators:
        simulator, attempt = first_attempt(simulators)
        done = simulate_expert(simulator, attempt)
    assert done.outcome.cause is FailureCause.TIME
    ticks = sum(len(state.actions.ctrl) for state in done.recorded_states)
    assert ticks <= 3.0 / 0.032 + 1


def test_each_cast_has_a_simulator_of_its_own(simulators: SimulatorCache) -> None:
    made = [simulators.get(AttemptJob(0, k)) for k in range(8)]
    kinds = {simulator.roles.config_names["cube"] for simulator in made if simulator.roles}
    assert kinds == {"cube_red", "cube_blue"} and len(set(map(id, made))) == 2


def test_things_come_in_sizes_that_the_record_tells(tmp_path: Path) -> None:
    task = changed({("things", "cube"): {"of": ["cube_red", "cube_blue"], "sizes": [0.8, 1.2]}})
    edges = set()
    with SimulatorCache(session_of(tmp_path, task)) as simulators:
        for number in range(6):
            simulator, attempt = first_attempt(simulators, number)
            assert attempt.roles is not None and attempt.layout is not None
            factor = attempt.roles.scale_factors["cube"]
            (cube,) = (item for item in simulator.config.task.objects if item.name == "cube")
            assert cube.shape is not None and cube.inertia.mass == pytest.approx(0.06179 * factor**3, rel=0.01)
            # It stands on the table, so its middle is half an edge above.
            low, high = _height(simulator, attempt)
            assert high - low == pytest.approx(0.045 * factor, abs=1e-4)
            edges.add(factor)
    assert edges == {0.8, 1.2}
    line = RoleAssignmentRecord.model_validate_json(
        to_json(RoleAssignmentRecord(things={}, kinds={}, sizes={"cube": 0.8}))
    )
    assert line.sizes == {"cube": 0.8}


def _height(simulator: Simulator, attempt: Attempt) -> tuple[float, float]:
    simulator.state_replay.set_state(attempt.start)  # type: ignore[arg-type]
    world = SimWorld(simulator.scene.model, simulator.state_replay.data, simulator.scene.arms, ("right",), ["cube"])
    low, high = world.aabb("cube")
    return float(low[2]), float(high[2])


def test_a_thing_starts_with_the_middle_of_what_it_is_when_open(tmp_path: Path) -> None:
    """With an open drawer, a cabinet reaches 260 mm ahead of its origin, and 100 mm behind it."""
    cabinet = {"x": [0.48, 0.48], "y": [0, 0], "yaw_deg": [0, 0], "open": {"drawer": [1, 1]}}
    task = changed(
        {
            ("rig",): STATION,
            ("things",): {"cabinet": {"of": "drawer_cabinet"}, "cube": {"of": "cube_red"}},
            ("starts",): {"cabinet": cabinet, "cube": {"x": [0.25, 0.35], "y": [0.25, 0.35]}},
            ("goal",): {"on": {"thing": "cube", "surface": "cabinet"}},
            ("expert",): [{"pick": {"thing": "cube"}}, {"place": {"thing": "cube", "on": "cabinet"}}],
        }
    )
    with SimulatorCache(session_of(tmp_path, task)) as simulators:
        _, attempt = first_attempt(simulators)
    assert attempt.layout is not None
    assert attempt.layout.T_in_world["cabinet"][0, 3] == pytest.approx(0.48 + 0.08, abs=2e-3)


def test_a_start_in_which_a_thing_still_moves_is_drawn_again(
    simulators: SimulatorCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator, calm = first_attempt(simulators)
    speeds = [1.0, 0.0]
    monkeypatch.setattr(sampling, "settle_objects", lambda *given: settle_objects(*given)._replace(speed=speeds.pop(0)))
    again = sampling.sample_attempt(simulator, calm.job)
    assert not speeds and again.layout is not None and calm.layout is not None
    assert not np.allclose(again.layout.T_in_world["cube"], calm.layout.T_in_world["cube"])
    # If objects move in every sample, the first sample is used.
    monkeypatch.setattr(sampling, "settle_objects", lambda *given: settle_objects(*given)._replace(speed=1.0))
    restless = sampling.sample_attempt(simulator, calm.job)
    assert restless.start is not None and np.array_equal(restless.start, calm.start)
