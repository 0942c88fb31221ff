"""Corrections: the expert completes failed trials of a policy, and the dataset says who acted."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.unrendered import change_frame, read_frame, write_dataset
from yamsim_cli import ChunkWindows, open_dataset
from yamsim_cli.api import API_SESSION_OPENER
from yamsim_cli.core.attempt_data import ActionSequence, AttemptJob, StepState
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episode, open_episodes
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode import execution
from yamsim_cli.core.episode.episode_rules import REPLAY_RULES
from yamsim_cli.core.errors import DatasetError, PartialJobError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.workers.executors import InlineExecutor
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.correction_record import EXPERT, POLICY, WHO
from yamsim_cli.corrections.correct import CorrectionReport, correct, require_corrections
from yamsim_cli.corrections.correction_runner import CorrectionRunner
from yamsim_cli.corrections.takeover import require_one_rigid_object, takeover_frame
from yamsim_cli.datasets.verify import ACTIONS, SEED, EpisodeVerifier, Tolerances
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialRunner
from yamsim_cli.recording.collect import EpisodeExecutor, RecordCallbacks
from yamsim_cli.recording.recording_output import RecordingOutput
from yamsim_cli.selection import (
    EpisodeDecision,
    Selection,
    apply_selection,
    episode_hash,
    select_actor,
    write_selection,
)

POLICIES = Path(__file__).parents[1] / "policies"
SEED_OF_TRIALS = 7
FRAME = 0.064  # s


class InlineFactory:
    """Runs trials in this process."""

    def __init__(self, choice: PolicyChoice, rewind_s: float) -> None:
        self._choice, self._rewind_s = choice, rewind_s

    def __call__(self, session: Session, workers: int) -> EpisodeExecutor:
        return InlineExecutor(lambda: CorrectionRunner(session, self._choice, self._rewind_s))


Run = Callable[..., CorrectionReport]


@pytest.fixture(scope="module")
def session() -> Session:
    opened = API_SESSION_OPENER.open("default", renders=False, seed=SEED_OF_TRIALS, camera=())
    return opened.with_values(cameras=())


@pytest.fixture(scope="module")
def run(session: Session) -> Run:
    """Return a function that corrects trials of a policy without images, into a directory."""

    def correct_trials(out: Path, name: str, n: int, rewind_s: float = 0.5, resume: bool = False, **given: Any) -> Any:
        mode = ExistingDatasetMode.RESUME if resume else ExistingDatasetMode.NEW
        choice = PolicyChoice(name, POLICIES, time_limit=6.0, arguments=given)
        callbacks = RecordCallbacks(lambda *_: None, lambda text: None)
        return correct(
            session.with_values(episodes=n),
            name,
            RecordingOutput(out, mode),
            InlineFactory(choice, rewind_s),
            callbacks,
            StopRequest(),
        )

    return correct_trials


HALFWAY = "halfway_policies.py:StopsHalfway"


@pytest.fixture(scope="module")
def made(run: Run, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CorrectionReport]:
    """Two trials: the policy succeeds in the first, and in the second stops with the object in its hand."""
    out = tmp_path_factory.mktemp("corrections") / "dataset"
    return out, run(out, HALFWAY, 2, share=0.6, fails_from=1)


def test_the_expert_completes_the_failed_trial_and_the_other_is_only_counted(
    made: tuple[Path, CorrectionReport],
) -> None:
    out, report = made
    assert (report.trials, report.policy_succeeded, report.recorded.episodes) == (2, 1, 1)
    assert (report.policy_faults, report.not_corrected) == ({}, {})
    lines = [json.loads(line) for line in (out / "attempts.jsonl").read_text().splitlines()]
    assert [(line["seed"], line["attempt"], line["episode"]) for line in lines] == [(7, 0, None), (7, 1, 0)]
    assert [(line["outcome"]["success"], line["outcome"]["cause"]) for line in lines] == [
        (False, "policy_succeeded"),
        (True, None),
    ]
    require_corrections(report)


def test_the_record_and_the_frames_say_who_acted(made: tuple[Path, CorrectionReport]) -> None:
    episode = open_episode(made[0] / "ep_000000")
    record, correction = episode.record, episode.record.correction
    assert correction is not None and record.source == "correct" and record.outcome.success
    assert (correction.policy, correction.ended, correction.cause) == (HALFWAY, "time_limit", "goal")
    assert correction.trial_ticks == round(6.0 / 0.032)
    assert correction.tick == 2 * correction.frame
    who = [frame[WHO] for frame in episode.frames()]
    assert who == [POLICY] * correction.frame + [EXPERT] * (record.frames - correction.frame)
    assert min(who.count(POLICY), who.count(EXPERT)) > 10
    assert open_episodes(made[0]).arrays()[WHO].tolist() == who


def test_the_policys_frames_are_those_of_its_trial_and_the_held_object_stays_in_the_hand(
    made: tuple[Path, CorrectionReport], session: Session
) -> None:
    episode = open_episode(made[0] / "ep_000000")
    frames, correction = episode.frames(), episode.record.correction
    assert correction is not None
    choice = PolicyChoice(HALFWAY, POLICIES, time_limit=6.0, arguments={"share": 0.6, "fails_from": 1})
    with TrialRunner(session, choice) as runner:
        trial = runner.run(AttemptJob(SEED_OF_TRIALS, 1))
    assert trial.actions is not None
    commands = np.concatenate([frame["sim_ctrl"] for frame in frames])
    assert np.array_equal(commands[: correction.tick], trial.actions.ctrl[: correction.tick])
    assert not np.array_equal(commands[correction.tick], trial.actions.ctrl[correction.tick])
    # The policy grasped the object before the takeover; the expert lets it go once, at its target.
    held = [frame["magnet"] for frame in frames]
    assert held[correction.frame - 1]
    assert sum(before and not after for before, after in itertools.pairwise(held)) == 1


def test_a_trial_is_simulated_once_and_its_states_are_those_of_its_actions(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The correction begins where the trial's own states say; no second simulation of the trial finds the moment."""
    choice = PolicyChoice(HALFWAY, POLICIES, time_limit=6.0, arguments={"share": 0.6})
    job = AttemptJob(SEED_OF_TRIALS, 1)
    with monkeypatch.context() as patched, CorrectionRunner(session, choice, 0.5) as runner:
        patched.setattr(execution, "run_with_pushes", lambda *_: pytest.fail("the trial is simulated again"))
        assert runner.run(job).correction is not None
    with TrialRunner(session, choice) as trials:
        trial, states = trials.run_with_states(job)
        assert trial.actions is not None
        again = execution.simulate_actions(trials.simulators.get(job), trial.attempt, trial.actions, REPLAY_RULES)
    assert len(states) == len(again.recorded_states) > 20
    for one, other in zip(states, again.recorded_states, strict=True):
        np.testing.assert_array_equal(one.qpos, other.qpos)


def test_verify_repeats_the_actions_bit_for_bit_and_finds_another_actor(
    made: tuple[Path, CorrectionReport], session: Session, tmp_path: Path
) -> None:
    directory = made[0] / "ep_000000"
    with EpisodeVerifier(session, Tolerances(0.0, None)) as verifier:
        verdict = verifier.run((0, directory))
        assert verdict.is_reproduced and set(verdict.checks) == {ACTIONS}
        assert verdict.skipped == {SEED: "it comes from 'correct', not from a seed"}
        copied = tmp_path / "ep_000000"
        copied.mkdir()
        for file in directory.rglob("*"):
            if file.is_file():
                (copied / file.relative_to(directory)).parent.mkdir(parents=True, exist_ok=True)
                (copied / file.relative_to(directory)).write_bytes(file.read_bytes())
        change_frame(copied, 3, rehash=True, who=1 - read_frame(copied, 3)[WHO])
        found = verifier.run((0, copied)).checks[ACTIONS].first_difference
        assert found is not None and (found.frame, found.quantity) == (3, WHO)


def test_who_keeps_the_frames_of_one_actor(made: tuple[Path, CorrectionReport], tmp_path: Path) -> None:
    (whole,) = open_dataset(made[0])
    (expert,), (policy,) = (open_dataset(made[0], who=who) for who in ("expert", "policy"))
    assert [frame[WHO] for frame in expert.frames()] == [EXPERT] * expert.record.frames
    assert [frame[WHO] for frame in policy.frames()] == [POLICY] * policy.record.frames
    times = [frame["timestamp"] for episode in (policy, expert) for frame in episode.frames()]
    assert times == [frame["timestamp"] for frame in whole.frames()]
    windows = ChunkWindows(open_dataset(made[0], who="expert"), chunk=4, cache=tmp_path)
    assert len(windows) == expert.record.frames
    # A person's trims apply too.
    taken, last = policy.record.frames, whole.record.frames - 1
    decision = EpisodeDecision(
        episode=0, decision="keep", sha256=episode_hash(whole.directory), first_frame=taken - 2, last_frame=last - 1
    )
    write_selection(file := tmp_path / "selection.yaml", Selection("dataset", "keep", {0: decision}))
    assert select_actor(made[0], "expert", apply_selection(made[0], file)).trims == {0: (taken, last - 1)}
    assert select_actor(made[0], "policy", apply_selection(made[0], file)).trims == {0: (taken - 2, taken - 1)}


def test_demonstrations_are_the_experts(
    tmp_path: Path, config: RecordConfig, locations: Locations, made: tuple[Path, CorrectionReport]
) -> None:
    write_dataset(path := tmp_path / "demos", config, locations, 1)
    assert "correction" not in json.loads((path / "ep_000000" / "episode.json").read_text())
    assert WHO not in read_frame(path / "ep_000000", 0)
    (expert,) = open_dataset(path, who="expert")
    assert expert.record.frames == open_dataset(path)[0].record.frames
    with pytest.raises(DatasetError, match="no frame in which the policy acts; give another dataset, or leave `who` o"):
        open_dataset(path, who="policy")
    with pytest.raises(UsageError, match=r"^who='human' is not valid: give expert or policy$"):
        open_dataset(path, who="human")  # type: ignore[arg-type]
    # Exports take the same frames.
    run = yamsim("export", "lerobot", path, tmp_path / "exported", "--no-pictures", "--who", "expert", "--json")
    assert run.code == 0, run.err
    assert run.json["selection"]["who"] == "expert" and run.json["frames"] == expert.record.frames
    run = yamsim("export", "lerobot", path, tmp_path / "other", "--no-pictures", "--who", "policy")
    assert run.code == 4 and "no frame in which the policy acts" in run.message


def test_a_summary_does_not_count_trials_in_which_the_policy_succeeded(
    made: tuple[Path, CorrectionReport],
) -> None:
    shown = yamsim("summarize", made[0], "--json")
    assert shown.code == 0, shown.err
    assert shown.json["problems"] == []
    attempts = shown.json["attempts"]
    assert (attempts["n"], attempts["n_success"], attempts["causes"]) == (1, 1, {})


def test_a_run_is_continued_and_says_that_there_was_nothing_to_correct(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "dataset"
    report = run(out, HALFWAY, 1, share=0.3, fails_from=1)
    with pytest.raises(PartialJobError, match=r"^nothing to correct: .* succeeded in all of 1 trial, so .* with --res"):
        require_corrections(report)
    report = run(out, HALFWAY, 2, resume=True, share=0.3, fails_from=1)
    assert (report.trials, report.policy_succeeded, report.recorded.episodes) == (2, 1, 1)


def test_a_fault_of_the_policy_is_not_corrected(tmp_path: Path, run: Run) -> None:
    report = run(tmp_path / "dataset", "sample_policies.py:Faulty", 2)
    assert report.policy_faults and not report.recorded.episodes
    with pytest.raises(PartialJobError, match=r"^no trial was corrected \(policy_"):
        require_corrections(report)


@pytest.mark.slow
def test_a_policy_that_never_fails_gives_one_line_and_exit_code_6(tmp_path: Path) -> None:
    run = yamsim("correct", "--policy", "scripted", "--n", "1", "--workers", "1", "--seed", "7", "--size", "32x24",
                 "--out", tmp_path / "dataset", "--json")  # fmt: skip
    assert run.code == 6
    assert run.json["policy_succeeded"] == run.json["trials"] == 1 and run.json["corrected"] == 0
    assert "yamsim: nothing to correct: scripted succeeded in all of 1 trial" in run.err.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.render
def test_corrections_with_the_config_of_a_recording_are_merged_with_it(tmp_path: Path) -> None:
    demos, fixed, joined = (tmp_path / name for name in ("demos", "fixed", "joined"))
    small = ("--workers", "1", "--size", "32x24", "--quality", "fast")
    assert yamsim("record", "--n", "1", "--seed", "3", "--wrist", *small, "--out", demos).code == 0
    run = yamsim("correct", "--policy", f"{POLICIES / 'halfway_policies.py'}:StopsHalfway", "--n", "1", "--seed", "7",
                 "--config", demos / "config.yaml", "--workers", "1", "--time-limit", "6", "--rewind-s", "0",
                 "--out", fixed, "--json")  # fmt: skip
    assert run.code == 0, run.err
    assert (run.json["trials"], run.json["corrected"], run.json["policy_succeeded"]) == (1, 1, 0)
    assert yamsim("merge", demos, fixed, "--out", joined).code == 0
    summary = yamsim("summarize", joined, "--json")
    # A warning: the episodes were made in two ways.
    assert summary.code == 0 and [problem["code"] for problem in summary.json["problems"]] == ["dataset.mixed"]
    verified = yamsim("verify", joined, "--json")
    assert verified.code == 0 and (verified.json["agree"], verified.json["max_error"]) == (2, 0.0)
    assert {name: found and found["episodes"] for name, found in verified.json["checks"].items()} == {
        "seed": 1, "actions": 2, "images": None,
    }  # fmt: skip
    shown = open_dataset(joined, who="expert")
    assert [episode.record.correction is None for episode in shown] == [True, False]
    assert shown[1].record.frames < open_dataset(joined)[1].record.frames
    assert shown[1].image("scene_camera", 0) == open_dataset(fixed, who="expert")[0].image("scene_camera", 0)


@pytest.mark.parametrize(
    ("task", "why"),
    [("fold_napkin", "handles cloth"), ("tower", r"handles 2 objects \(.*\), and would move them all again")],
)
def test_tasks_in_which_the_expert_cannot_take_over_are_refused(task: str, why: str) -> None:
    config = API_SESSION_OPENER.load_record_config("default", API_SESSION_OPENER.find_locations(), task=task)
    with pytest.raises(UsageError, match=f"^--task {task}: its expert {why}"):
        require_one_rigid_object(config.task)


def test_the_trial_is_rewound_from_its_last_motion() -> None:
    none = ActionSequence(np.zeros((0, 7)), np.zeros((0, 1), bool), np.zeros((0, 1, 7)))

    def states(positions: list[float]) -> list[StepState]:
        return [StepState(k * FRAME, np.array([position, 0.2]), none) for k, position in enumerate(positions)]

    moving = [0.01 * k for k in range(11)]
    assert takeover_frame(states(moving), 0.0, FRAME) == 10
    assert takeover_frame(states(moving + [0.1] * 50), 0.0, FRAME) == 10
    assert takeover_frame(states(moving + [0.1] * 50), 3 * FRAME, FRAME) == 7
    # The expert never takes over later than asked.
    assert takeover_frame(states(moving + [0.1] * 50), 3.5 * FRAME, FRAME) == 6
    assert takeover_frame(states(moving), 100.0, FRAME) == 0
    assert takeover_frame(states([0.0] * 9), 0.0, FRAME) == 0
