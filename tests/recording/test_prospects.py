"""An impossible task is given up soon, with any executor; one that only fails often is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.recording.fake_episodes import Inline, Recording, payload
from yamsim_cli.core.attempt_data import Attempt, AttemptJob, AttemptPayload, FailureCause, Outcome
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.recording.retry_limit import RetryLimitError, all_starts_fail

Make = Callable[..., RecordConfig]
Asked = list[tuple[FailureCause, int]]


@pytest.fixture
def recording(make_config: Make, tmp_path: Path) -> Recording:
    return Recording(make_config({("episodes",): 5, ("seed",): 1}), tmp_path / "dataset")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """Record the requested starts, all of which are out of reach."""
    asked: Asked = []

    def answer(session: Session, cause: FailureCause, first: int) -> bool:
        asked.append((cause, first))
        return cause is FailureCause.UNREACHABLE

    monkeypatch.setattr("yamsim_cli.recording.recorder.all_starts_fail", answer)
    return asked


def failing(
    cause: FailureCause, but: Callable[[int], bool] = lambda attempt: False
) -> Callable[[AttemptJob], AttemptPayload]:
    """Every attempt fails for a cause, except some."""

    def make(job: AttemptJob) -> AttemptPayload:
        if but(job.attempt):
            return replace(payload(AttemptJob(job.seed, 0)), attempt=Attempt(job))
        return AttemptPayload(Attempt(job), Outcome(False, cause, f"failed for the {job.attempt}th time"))

    return make


@pytest.mark.parametrize("workers", [1, 3, 8])
def test_ten_that_fail_in_one_way_are_enough_where_no_start_is_better(
    recording: Recording, asked: Asked, workers: int
) -> None:
    with pytest.raises(SimulationError) as caught:
        recording.run(Inline(failing(FailureCause.UNREACHABLE)), workers=workers)
    assert recording.causes() == ["unreachable"] * 10
    assert asked == [(FailureCause.UNREACHABLE, 10)]
    message = str(caught.value)
    assert message == (
        "task 'pickplace' cannot succeed: its first 10 attempts failed with the same cause, and the starts of 100 more "
        "have the same problem; 10 unreachable (failed for the 9th time); look at `starts`, the steps of `expert`, and "
        "where the rig's arms stand; after a change, record with --overwrite, or to another --out"
    )


def test_resuming_what_cannot_work_is_refused_before_anything_is_made(recording: Recording, asked: Asked) -> None:
    with pytest.raises(SimulationError):
        recording.run(Inline(failing(FailureCause.UNREACHABLE)))
    executor = Inline(failing(FailureCause.UNREACHABLE))
    with pytest.raises(SimulationError, match="task 'pickplace'"):
        recording.resume(executor)
    assert executor.made == []
    assert len(recording.causes()) == 10


def test_recording_goes_on_if_a_later_start_is_better(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def answer(session: Session, cause: FailureCause, first: int) -> bool:
        asked.append(first)
        return False

    monkeypatch.setattr("yamsim_cli.recording.recorder.all_starts_fail", answer)
    recording.run(Inline(failing(FailureCause.UNREACHABLE, but=lambda attempt: attempt >= 25)))
    assert recording.causes() == ["unreachable"] * 25 + [None] * 5
    assert asked == [10], "once is enough"


def test_one_success_or_another_cause_among_the_first_is_hope(recording: Recording, asked: Asked) -> None:
    recording.run(Inline(failing(FailureCause.UNREACHABLE, but=lambda attempt: attempt % 20 == 4)))
    assert recording.causes().count("unreachable") > 40

    def mixed(job: AttemptJob) -> AttemptPayload:
        cause = FailureCause.SLIPPED if job.attempt == 5 else FailureCause.UNREACHABLE
        return failing(cause, but=lambda attempt: attempt >= 50)(job)

    recording.path = recording.path.with_name("mixed")
    recording.run(Inline(mixed))
    assert len(recording.causes()) == 55
    assert asked == []


@pytest.mark.parametrize("workers", [1, 8])
def test_what_physics_decides_is_believed_after_a_hundred(recording: Recording, asked: Asked, workers: int) -> None:
    recording.config = recording.config.model_copy(update={"episodes": 500})

    def mixed(job: AttemptJob) -> AttemptPayload:
        return failing(FailureCause.OFF_TARGET if job.attempt % 4 else FailureCause.DROPPED)(job)

    with pytest.raises(SimulationError) as caught:
        recording.run(Inline(mixed), workers=workers)
    assert len(recording.causes()) == 100
    message = str(caught.value)
    assert "none of 100 attempts succeeded; 75 off_target, 25 dropped (failed for the 99th time); look at" in message
    assert "--resume" not in message


@pytest.mark.parametrize("workers", [1, 8])
def test_a_task_that_works_too_rarely_is_given_up_with_what_there_is(recording: Recording, workers: int) -> None:
    with pytest.raises(RetryLimitError) as caught:
        recording.run(Inline(failing(FailureCause.SLIPPED, but=lambda attempt: attempt % 30 == 0)), workers=workers)
    assert len(recording.causes()) == 100
    message = str(caught.value)
    assert message.startswith(
        "gave up after 100 attempts: only 4 succeeded, and at least 1 of 20 must; "
        "96 slipped (failed for the 99th time); look at the object's `grasp.friction`"
    )
    assert message.endswith(f"; 4 of 5 episodes are complete in {recording.path}")
    assert "--resume" not in message
    assert caught.value.exit_code == 6


def test_a_lone_episode_is_given_as_many_attempts(recording: Recording) -> None:
    """With 20 attempts, one in 87 recordings of a task with success rate 1/5 would be given up."""
    recording.config = recording.config.model_copy(update={"episodes": 1})
    report = recording.run(Inline(failing(FailureCause.SLIPPED, but=lambda attempt: attempt == 60)))
    assert (report.episodes, report.attempts) == (1, 61)


FAR = {("task", "starts", role, "x"): [0.80, 1.05] for role in ("object", "target")}
FARTHER_AND_FARTHER = {("task", "starts", role, "x"): [0.55, 1.00] for role in ("object", "target")}


@pytest.mark.parametrize(
    ("changes", "cause", "wanted"),
    [
        (FAR, FailureCause.UNREACHABLE, True),
        (FARTHER_AND_FARTHER, FailureCause.UNREACHABLE, False),
        ({}, FailureCause.UNREACHABLE, False),
        pytest.param(
            {("rig",): "bimanual", ("arm",): "left", **FAR}, FailureCause.UNREACHABLE, True, marks=pytest.mark.slow
        ),
        pytest.param(
            {("rig",): "russet", ("task",): "handover", **FAR}, FailureCause.UNREACHABLE, True, marks=pytest.mark.slow
        ),
        ({("rig",): "russet", ("task",): "handover"}, FailureCause.UNREACHABLE, False),
        pytest.param(
            {("task", "starts", "target", "apart"): 0.9}, FailureCause.NO_LAYOUT, True, marks=pytest.mark.slow
        ),
        ({("task", "starts", "target", "apart"): 0.1}, FailureCause.NO_LAYOUT, False),
        # Only physics can tell.
        (FAR, FailureCause.SLIPPED, False),
    ],
)
def test_starts_tell_whether_anything_is_in_reach(
    make_config: Make,
    locations: Locations,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[tuple[str, ...], object],
    cause: FailureCause,
    wanted: bool,
) -> None:
    monkeypatch.setattr("yamsim_cli.recording.retry_limit.CHECKED_STARTS", 20)
    assert all_starts_fail(Session(make_config(changes), locations), cause, 10) is wanted
