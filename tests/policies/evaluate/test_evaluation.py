"""Trials of policies: the batch's starts, its verdicts, and every fault of a policy."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.attempts import all_actions, planned
from tests.unrendered import write_dataset
from yamsim_cli.core.attempt_data import ActionSequence, Attempt, AttemptJob, FailureCause, Outcome
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import OutcomeRecord
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.episode_rules import EndRule, EpisodeRules
from yamsim_cli.core.episode.simulator import Simulator, open_episode
from yamsim_cli.core.errors import PartialJobError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.action_chunks import ChunkSettings
from yamsim_cli.policies.evaluate.evaluation import (
    Evaluation,
    evaluate,
    evaluation_report,
    require_measured_trials,
    trials_to_film,
)
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd, TrialResult, TrialRunner
from yamsim_cli.trials import run_expert_trials

SAMPLES = Path(__file__).parents[1]
N = 12


def _line_of(code: str) -> int:
    """Line number of code in the samples."""
    lines = (SAMPLES / "sample_policies.py").read_text().splitlines()
    return 1 + next(number for number, line in enumerate(lines) if line.strip() == code)


@pytest.fixture(scope="module")
def strict(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    """A threshold at which the plan sometimes fails."""
    changes = {("task", "goal", "on", "radius"): 0.003, ("episodes",): N, ("seed",): 2, ("workers",): 2}
    return make_config(changes | {("wrist",): True, ("image", "size_px"): [48, 36]})


@pytest.fixture
def trial(config: RecordConfig, locations: Locations) -> Iterator[Callable[..., TrialResult]]:
    """One trial of a sample policy, or of a built-in one."""

    def run(name: str, attempt: int = 0, seed: int = 0, **limits: Any) -> TrialResult:
        choice = PolicyChoice(name, SAMPLES, **limits)
        with TrialRunner(Session(config, locations), choice) as runner:
            return runner.run(AttemptJob(seed, attempt))

    yield run


def rest(config: RecordConfig) -> int:
    """Control ticks of standing still after a policy is done, if the goal never holds."""
    return config.task.timing.settle_ticks + config.task.hold_ticks


def outcomes(report: dict[str, Any]) -> list[Any]:
    """Outcomes trial by trial; of a failure its cause alone, since a policy waits until everything is at rest again."""
    return [
        (trial["trial"], trial["seed"], outcome if outcome["success"] else outcome["cause"], [*trial["layout"].items()])
        for trial in report["trials"]
        for outcome in [trial["outcome"]]
    ]


@pytest.mark.slow
def test_the_scripted_policy_does_exactly_what_the_batch_does(strict: RecordConfig, locations: Locations) -> None:
    """All numbers of every success, and causes of failures, for any number of workers."""
    batch = run_expert_trials(Session(strict, locations), (0.05,), lambda *_: None)
    found = evaluate(Session(strict, locations), PolicyChoice("scripted", SAMPLES, end=EndRule.ACTOR), lambda *_: None)
    report = json.loads(json.dumps(evaluation_report(found, strict, (0.05,))))
    batch = json.loads(json.dumps(batch))
    assert 0 < report["stats"]["n_success"] < N
    assert outcomes(report) == outcomes(batch)
    for key in ("n", "n_success", "success_rate", "wilson95", "rates", "causes"):
        assert report["stats"][key] == batch[key], key
    assert set(report["stats"]["ended"]) == {"done"}


@pytest.mark.slow
def test_holding_still_scores_nothing(strict: RecordConfig, locations: Locations) -> None:
    found = evaluate(Session(strict, locations), PolicyChoice("hold_still", SAMPLES, time_limit=1.0), lambda *_: None)
    report = evaluation_report(found, strict, (0.08,))
    assert (report["stats"]["n_success"], report["stats"]["rates"]["0.08"]) == (0, 0.0)
    assert report["stats"]["ended"] == {"time_limit": N}
    assert {trial["simulated_s"] for trial in report["trials"]} == {31 * 0.032}


def test_a_datasets_actions_are_replayed_on_their_own_starts(
    config: RecordConfig, locations: Locations, tmp_path: Path, trial: Callable[..., TrialResult]
) -> None:
    write_dataset(tmp_path / "dataset", config, locations, 2)
    name = f"replay:{tmp_path / 'dataset'}"
    own = trial(name, attempt=1)
    assert own.outcome.success
    assert own.outcome.dxy_m == trial("scripted", attempt=1).outcome.dxy_m
    # From a start that is not in the dataset, replay fails.
    assert not trial(name, attempt=7).outcome.success
    with pytest.raises(UsageError, match="nothing: it has no episodes"):
        trial(f"replay:{tmp_path / 'nothing'}")


def test_the_closed_loop_is_the_simulation_bit_for_bit(config: RecordConfig, locations: Locations) -> None:
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, 0, 3)
        assert done.attempt.start is not None
        episode = open_episode(simulator, done.attempt, EpisodeRules())
        for state in done.recorded_states:
            np.testing.assert_array_equal(episode.data.qpos, state.qpos)
            for ctrl, magnet in zip(state.actions.ctrl, state.actions.magnet, strict=True):
                episode.step(ctrl[simulator.scene.recorded_drive_ctrl], magnet)
        np.testing.assert_array_equal(episode.executed_actions.magnet, all_actions(done.recorded_states).magnet)
        assert episode.executed_actions.magnet.any()


def test_the_weld_does_not_reach_across_the_table(config: RecordConfig, trial: Callable[..., TrialResult]) -> None:
    """A policy that always commands the weld, far from the object, holds nothing."""
    result = trial("sample_policies.py:Faulty", attempt=4)
    assert (result.ended, result.ticks) == (TrialEnd.DONE, 6 + rest(config))
    assert result.actions is not None
    assert not result.actions.magnet.any()


def test_what_is_still_held_at_the_end_stays_held(config: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    """Once the policy is done everything stands still, and an object held over the plate does not count as placed."""
    (tmp_path / "holder.py").write_text(
        "from yamsim_cli.policies.evaluate.policy_factory import ExpertPolicy\n\n\nclass Holder(ExpertPolicy):\n"
        "    def __call__(self, observation):\n        action = super().__call__(observation)\n"
        "        return {**action, 'done': action['magnet'].any() and not self._weld_on[self._tick].any()}\n"
    )
    with TrialRunner(Session(config, locations), PolicyChoice("holder.py:Holder", tmp_path)) as runner:
        result = runner.run(AttemptJob(0, 0))
    assert result.actions is not None
    done = -1 - rest(config)
    assert result.ended is TrialEnd.DONE
    assert result.actions.magnet[done:].all()
    assert (result.actions.ctrl[done:] == result.actions.ctrl[done]).all()
    assert result.outcome.dxy_m is not None and result.outcome.dxy_m < 0.01
    assert (result.outcome.success, result.outcome.cause) == (False, "goal")
    assert result.outcome.detail == "on(banana, plate): the right hand holds it"


@pytest.mark.parametrize(
    ("seed", "ended", "told"),
    [
        (0, TrialEnd.RAISED, "KeyError: 'no such thing' (sample_policies.py:{line}, in __call__), after 3 ticks"),
        (1, TrialEnd.INVALID, "nan"),
        (2, TrialEnd.INVALID, "(6,)"),
        (3, TrialEnd.SLOW, "no answer within 0.5 s, after 3 ticks"),
    ],
)
def test_a_fault_costs_its_trial_alone(
    seed: int, ended: TrialEnd, told: str, trial: Callable[..., TrialResult], capsys: pytest.CaptureFixture[str]
) -> None:
    result = trial("sample_policies.py:Faulty", attempt=seed, call_seconds=0.5)
    assert result.ended is ended
    assert told.format(line=_line_of('raise KeyError("no such thing")')) in result.error
    assert (result.outcome.success, result.outcome.cause, result.outcome.detail) == (False, ended.value, result.error)
    # The motion until then is judged.
    assert result.outcome.dxy_m is not None
    assert result.ticks == 3
    assert capsys.readouterr().out == ""


def test_the_result_has_the_whole_traceback_of_a_policy(trial: Callable[..., TrialResult], tmp_path: Path) -> None:
    """The line of the user's that called what raised; in the traceback all of them, and none of yamsim's."""
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n\n\ndef inverted(matrix):\n    return np.linalg.inv(matrix)\n\n\n"
        "class Mine:\n    images = ()\n    def reset(self):\n        pass\n"
        "    def __call__(self, observation):\n        return {'ctrl': inverted(np.zeros((2, 2)))}\n"
    )
    result = trial(f"{tmp_path}/mine.py:Mine")
    assert result.error == f"LinAlgError: Singular matrix ({tmp_path}/mine.py:5, in inverted), after 0 ticks"
    first, *_, last = result.traceback.strip().splitlines()
    assert (first, last) == ("Traceback (most recent call last):", "numpy.linalg.LinAlgError: Singular matrix")
    assert "return {'ctrl': inverted(np.zeros((2, 2)))}" in result.traceback
    assert "yamsim_cli" not in result.traceback
    assert trial("sample_policies.py:Still", time_limit=0.1).traceback == ""


@pytest.mark.slow
def test_a_fork_that_a_policy_leaves_behind_answers_for_no_trial(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("episodes",): 4, ("workers",): 1})
    found = evaluate(Session(config, locations), PolicyChoice("sample_policies.py:Forker", SAMPLES), lambda *_: None)
    assert [result.attempt.job.attempt for result in found.results] == [0, 1, 2, 3]
    assert {(result.ended, result.ticks) for result in found.results} == {(TrialEnd.DONE, 3 + rest(config))}


@pytest.mark.slow
def test_a_policy_that_ends_its_process_costs_its_trial_alone(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("episodes",): 3, ("workers",): 1})
    found = evaluate(Session(config, locations), PolicyChoice("sample_policies.py:Suicidal", SAMPLES), lambda *_: None)
    assert [result.ended for result in found.results] == [TrialEnd.DONE, TrialEnd.LOST, TrialEnd.DONE]
    assert "ended with code 3, in each of 3 tries" in found.results[1].error
    assert evaluation_report(found, config, (0.05,))["stats"]["causes"]["policy_lost"] == 1


@pytest.mark.parametrize(
    ("ended", "ran"),
    [
        ((TrialEnd.RAISED, TrialEnd.DONE), True),
        ((TrialEnd.TIME_LIMIT, TrialEnd.LOST), True),
        ((TrialEnd.RAISED, TrialEnd.LOST), False),
        ((TrialEnd.SLOW, TrialEnd.INVALID), False),
        ((TrialEnd.NOT_STARTED, TrialEnd.NOT_STARTED), False),
    ],
)
def test_trials_that_did_not_run_measure_nothing(ended: tuple[TrialEnd, ...], ran: bool, config: RecordConfig) -> None:
    outcome = OutcomeRecord.from_outcome(Outcome(False, FailureCause.NO_LAYOUT, "no free place"))
    results = tuple(TrialResult(Attempt(AttemptJob(0, k)), outcome, how) for k, how in enumerate(ended))
    report = evaluation_report(
        Evaluation(PolicyChoice("mine.py", SAMPLES), results, 1.0, ("banana", "pear")), config, ()
    )
    with contextlib.nullcontext() if ran else pytest.raises(PartialJobError, match=r"no trial of mine.py .*no free"):
        require_measured_trials(report)


def test_failures_are_shown_and_successes_on_request() -> None:
    acting = ActionSequence(np.zeros((1, 7)), np.zeros((1, 1), bool), np.zeros((1, 1, 7)))
    results = [
        TrialResult(
            Attempt(AttemptJob(0, k)), OutcomeRecord.from_outcome(Outcome(good)), TrialEnd.DONE, actions=actions
        )
        for k, (good, actions) in enumerate([(True, acting), (False, None), (False, acting), (True, acting)])
    ]
    assert trials_to_film(results, 9, successes=False) == [results[2]]
    assert trials_to_film(results, 9, successes=True) == [results[0], *results[2:]]
    assert trials_to_film(results, 2, successes=True) == [results[0], results[2]]
    assert trials_to_film([results[0]], 9, successes=False) == [results[0]]


def test_a_random_policy_is_seeded_by_its_trial(trial: Callable[..., TrialResult]) -> None:
    one, again, other = (trial("sample_policies.py:Random", attempt=k, time_limit=0.5) for k in (2, 2, 3))
    assert one.actions is not None
    assert again.actions is not None
    assert other.actions is not None
    np.testing.assert_array_equal(one.actions.ctrl, again.actions.ctrl)
    assert np.abs(one.actions.ctrl - other.actions.ctrl).max() > 1e-3


@pytest.mark.parametrize("latency", [0.0, 0.08])
def test_verdicts_do_not_depend_on_the_machine(
    latency: float, trial: Callable[..., TrialResult], config: RecordConfig, locations: Locations
) -> None:
    """Slow answers and a simulated latency: the same states, bit for bit."""
    quick, slow = (
        trial(f"sample_policies.py:{name}", 2, time_limit=0.6, chunking=ChunkSettings(latency=latency))
        for name in ("Random", "Loaded")
    )
    assert quick.actions is not None and slow.actions is not None
    np.testing.assert_array_equal(quick.actions.ctrl, slow.actions.ctrl)
    assert (quick.outcome, quick.ended, quick.chunk_stats) == (slow.outcome, slow.ended, slow.chunk_stats)
    assert max(slow.seconds) >= 0.02


def test_a_trial_says_where_the_object_was_grasped_and_left(trial: Callable[..., TrialResult]) -> None:
    done = trial("scripted", attempt=1)
    assert done.offset is not None and done.offset_in_hand is not None
    assert math.hypot(*done.offset) == done.outcome.dxy_m
    # The weld takes an object within 6 cm of the pinch site, here a banana of 19 cm.
    assert 0 < math.hypot(*done.offset_in_hand) < 0.1
    still = trial("hold_still", attempt=1, time_limit=0.2)
    assert still.offset is not None
    assert (math.hypot(*still.offset), still.offset_in_hand) == (still.outcome.dxy_m, None)


def test_a_report_says_with_which_settings_it_ran(config: RecordConfig, locations: Locations) -> None:
    """Of chunks those that acted: a policy's own where none are given."""
    choice = PolicyChoice(
        "sample_policies.py:Chunked",
        SAMPLES,
        10,
        0.32,
        arguments={"actions": 6},
        chunking=ChunkSettings(3, 0.01, 0.064),
    )
    with TrialRunner(Session(config, locations), choice) as runner:
        result = runner.run(AttemptJob(0, 0))
    report = json.loads(json.dumps(evaluation_report(Evaluation(choice, (result,), 1.0, ("banana",)), config, ())))
    assert report["settings"] == {
        "policy_arguments": {"actions": 6},
        "policy_config": None,
        "execute": 3,
        "ensemble": 0.01,
        "latency_s": 0.064,
        "time_limit_s": 0.32,
        "policy_timeout_s": 10,
        "size_px": list(config.image.size_px),
        "quality": config.render.name,
        "randomization": "none",
        "randomized": [],
        "camera_effects": [],
    }
    assert report["trials"][0]["offset_m"] == report["stats"]["offset_m"]["mean"] == list(result.offset or ())
    assert report["stats"]["offset_in_hand_m"] is None


@pytest.mark.render
def test_a_policy_sees_what_it_asks_for(strict: RecordConfig, locations: Locations) -> None:
    with TrialRunner(Session(strict, locations), PolicyChoice("sample_policies.py:Seeing", SAMPLES)) as runner:
        result = runner.run(AttemptJob(0, 0))
    assert (result.ended, result.ticks, result.error) == (TrialEnd.DONE, 1 + rest(strict), "")


def test_an_observation_says_where_everything_is(config: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    """The same numbers as a recorded frame of the same state, in `world`."""
    (tmp_path / "spy.py").write_text(
        "class Spy:\n    images = ()\n    seen = []\n    def reset(self):\n        pass\n"
        "    def __call__(self, observation):\n        type(self).seen.append(observation)\n"
        "        return {'ctrl': observation['joints'], 'done': True}\n"
    )
    with TrialRunner(Session(config, locations), PolicyChoice("spy.py", tmp_path)) as runner:
        runner.run(AttemptJob(0, 0))
        seen = type(runner.policy).seen[0]  # type: ignore[attr-defined]
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, 0)
        frame = frame_records(simulator, done.attempt, done.recorded_states[:1])[0]
        T_base = simulator.scene.T_base_in_world
    np.testing.assert_allclose(seen["joints"], frame["joints"], atol=1e-6)
    np.testing.assert_allclose(seen["gripper"], frame["joints"][6], atol=1e-6)
    np.testing.assert_allclose(seen["ee_pose_world"], T_base @ frame["ee_pose"], atol=1e-6)
    np.testing.assert_allclose(seen["K_scene"], frame["intrinsics"]["scene_camera"], rtol=1e-6)
    np.testing.assert_allclose(seen["T_cam_in_world"], T_base @ frame["extrinsics"]["scene_camera"], atol=1e-6)
    assert (seen["time"], seen["prompt"]) == (0.0, frame["language_prompt"])
