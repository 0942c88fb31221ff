from __future__ import annotations

import json
import math
import os
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path, PurePosixPath
from types import SimpleNamespace

import pytest

from tests.core.dataset.making import tree
from tests.recording.fake_episodes import Inline, Recording, payload
from yamsim_cli.core.attempt_data import Attempt, AttemptJob, AttemptPayload, FailureCause, Outcome
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.records import AttemptRecord
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import DatasetError, InterruptedJobError, PartialJobError, ResourceError
from yamsim_cli.core.expert.skills.program import typical_tick_count
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.filesystem_mounts import Mount
from yamsim_cli.terminal.signals import stop_on_signal

Make = Callable[..., RecordConfig]


@pytest.fixture
def recording(make_config: Make, tmp_path: Path) -> Recording:
    return Recording(make_config({("episodes",): 5, ("seed",): 1}), tmp_path / "dataset")


@pytest.fixture
def undisturbed(make_config: Make, tmp_path: Path) -> dict[str, bytes]:
    one = Recording(make_config({("episodes",): 5, ("seed",): 1}), tmp_path / "undisturbed")
    one.run()
    return tree(one.path)


def test_episodes_are_the_successes_in_order_of_attempt(recording: Recording) -> None:
    report = recording.run()
    assert (report.episodes, report.attempts) == (5, 7)
    lines = [json.loads(line) for line in (recording.path / "attempts.jsonl").read_text().splitlines()]
    assert [line["episode"] for line in lines] == [0, None, 1, 2, None, 3, 4]
    for line in lines:
        if line["episode"] is not None:
            record = json.loads((recording.path / f"ep_{line['episode']:06d}/episode.json").read_text())
            assert record["attempt"] == line["attempt"]


@pytest.mark.parametrize("workers", [1, 3, 8])
def test_the_bytes_do_not_depend_on_how_many_work(
    recording: Recording, undisturbed: dict[str, bytes], workers: int
) -> None:
    recording.run(workers=workers)
    assert tree(recording.path) == undisturbed


def test_no_attempt_is_begun_that_cannot_be_needed(recording: Recording) -> None:
    executor = Inline()
    recording.run(executor, workers=16)
    assert sorted(executor.made) == list(range(7))


def test_an_attempt_that_loses_its_workers_is_a_failure_like_others(recording: Recording) -> None:
    report = recording.run(Inline(lose={2}))
    assert (report.episodes, report.attempts) == (5, 9)
    assert recording.causes()[:4] == [None, "off_target", "worker_lost", None]
    assert "ended its worker 3 times; the last one fell over" in (recording.path / "attempts.jsonl").read_text()
    assert recording.warnings == [
        "Attempt 2 ended its worker 3 times; the last one fell over. "
        "It counts as a failure, unless the next attempts end their workers too."
    ]


def test_a_lost_attempt_stays_lost_when_the_recording_is_resumed(recording: Recording) -> None:
    recording.config = recording.config.model_copy(update={"episodes": 3})
    recording.run(Inline(lose={2}))
    recording.config = recording.config.model_copy(update={"episodes": 5})
    executor = Inline()
    recording.resume(executor)
    assert 2 not in executor.made
    assert recording.causes()[2] == "worker_lost"


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_a_machine_that_loses_every_worker_is_not_believed(
    recording: Recording, undisturbed: dict[str, bytes], workers: int
) -> None:
    """Attempts are not given up when none that began later came back: the next run makes them."""
    with pytest.raises(PartialJobError, match=r"3 attempts in a row lost .*: [01] of 5 episodes"):
        recording.run(Inline(lose=set(range(1, 100))), workers=workers)
    assert "worker_lost" not in recording.causes()
    recording.resume()
    assert tree(recording.path) == undisturbed


def test_an_episode_that_cannot_be_made_again_is_named(recording: Recording) -> None:
    recording.run()
    (recording.path / "ep_000001/lowdim/000000.pkl").unlink()
    with pytest.raises(PartialJobError, match=r"ep_000001 cannot be made again: .* 4 of 5 episodes"):
        recording.resume(Inline(lose={2}))
    with pytest.raises(DatasetError, match=r"attempt 2 was recorded as ep_000001, but fails now \(dropped\)"):
        recording.resume(Inline(lambda job: AttemptPayload(Attempt(job), Outcome(False, FailureCause.DROPPED))))


def test_a_damaged_episode_is_made_again_and_the_user_told(recording: Recording, undisturbed: dict[str, bytes]) -> None:
    recording.run()
    (recording.path / "ep_000001/lowdim/000000.pkl").write_bytes(b"")
    executor = Inline()
    recording.resume(executor)
    assert executor.made == [2]
    assert "ep_000001: lowdim/000000.pkl is not what was recorded" in recording.warnings[0]
    damaged = {name for name in tree(recording.path) if name.startswith(".damaged/")}
    assert {name: data for name, data in tree(recording.path).items() if name not in damaged} == undisturbed
    assert damaged


def spoil(recording: Recording, *numbers: int, by: bytes = b"{\n") -> None:
    """Replace lines of the ledger."""
    ledger = recording.path / "attempts.jsonl"
    lines = ledger.read_bytes().splitlines(keepends=True)
    for number in numbers:
        lines[number] = by
    ledger.write_bytes(b"".join(lines))


def without_damaged(path: Path) -> dict[str, bytes]:
    return {name: data for name, data in tree(path).items() if not name.startswith(".damaged/")}


@pytest.mark.parametrize("staged", [False, True])
@pytest.mark.parametrize("lost", [(0,), (1,), (6,), (1, 2, 4), tuple(range(7))], ids=str)
def test_what_a_broken_line_said_is_found_out_again(
    recording: Recording, undisturbed: dict[str, bytes], tmp_path: Path, lost: tuple[int, ...], staged: bool
) -> None:
    """Attempts 1 and 4 failed; the episodes tell the others."""
    recording.run()
    spoil(recording, *lost)
    spoiled = (recording.path / "attempts.jsonl").read_bytes()
    recording.stage = tmp_path / "stage" if staged else None
    executor = Inline()
    report = recording.resume(executor)
    assert sorted(executor.made) == sorted({1, 4} & set(lost))
    assert (report.episodes, report.attempts) == (5, 7)
    assert without_damaged(recording.path) == undisturbed
    assert (recording.path / ".damaged/attempts.jsonl.1").read_bytes() == spoiled
    assert "attempts.jsonl was damaged (line" in recording.warnings[0]


def test_a_line_and_its_episode_can_both_be_lost(recording: Recording, undisturbed: dict[str, bytes]) -> None:
    recording.run()
    spoil(recording, 2, 4)
    shutil.rmtree(recording.path / "ep_000001")
    executor = Inline()
    recording.resume(executor)
    assert sorted(executor.made) == [2, 4]
    assert without_damaged(recording.path) == undisturbed


def test_a_stop_before_a_lost_line_is_told_again_loses_nothing(
    recording: Recording, undisturbed: dict[str, bytes]
) -> None:
    recording.run()
    spoil(recording, 1, 4)

    def interrupted(job: AttemptJob) -> AttemptPayload:
        if job.attempt == 4:
            raise KeyboardInterrupt
        return payload(job)

    with pytest.raises(InterruptedJobError, match=r"5 of 5 episodes"):
        recording.run(Inline(interrupted), ExistingDatasetMode.RESUME, workers=1)
    recording.resume()
    assert without_damaged(recording.path) == undisturbed


@pytest.mark.parametrize("again", ["lost", "well"])
def test_an_attempt_that_lost_its_workers_stays_without_an_episode(recording: Recording, again: str) -> None:
    """Its line is lost too; the following episodes show that it gave none."""
    recording.run(Inline(lose={2}))
    before = tree(recording.path)
    spoil(recording, 2)
    recording.resume(Inline(lose={2} if again == "lost" else set()))
    assert recording.causes()[:4] == [None, "off_target", "worker_lost", None]
    ledger = {"attempts.jsonl"}
    now = without_damaged(recording.path)
    assert {k: now[k] for k in now.keys() - ledger} == {k: before[k] for k in before.keys() - ledger}
    if again == "lost":
        assert now == before


def test_an_attempt_that_must_have_succeeded_and_fails_now_is_named(recording: Recording) -> None:
    recording.run()
    spoil(recording, 2)
    shutil.rmtree(recording.path / "ep_000001")
    for _ in range(2):
        with pytest.raises(DatasetError, match=r"attempt 2 .*ep_000001"):
            recording.resume(Inline(lambda job: AttemptPayload(Attempt(job), Outcome(False, FailureCause.DROPPED))))
        with pytest.raises(PartialJobError, match="attempt 2 cannot be made again"):
            recording.resume(Inline(lose={2}))


def test_a_wish_to_stop_lets_attempts_in_hand_finish_and_begins_no_other(
    recording: Recording, undisturbed: dict[str, bytes]
) -> None:
    def stopping(job: AttemptJob) -> AttemptPayload:
        recording.stop.request_stop()
        return payload(job)

    executor = Inline(stopping)
    with pytest.raises(
        InterruptedJobError, match=r"interrupted: 2 of 5 episodes are complete in .*, 3 are left; .*--resume"
    ):
        recording.run(executor, workers=3)
    assert sorted(executor.made) == [0, 1, 2]
    assert (recording.path / "manifest.json").is_file()
    recording.stop = StopRequest()
    recording.resume()
    assert tree(recording.path) == undisturbed


def test_a_wish_to_stop_does_not_wait_for_ever(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(job: AttemptJob) -> AttemptPayload:
        recording.stop.request_stop()
        raise TimeoutError

    monkeypatch.setattr(StopRequest, "seconds_since_request", 61.0)
    with pytest.raises(InterruptedJobError):
        recording.run(Inline(hang))


def test_ctrl_c_ends_it_at_once_and_loses_nothing(recording: Recording, undisturbed: dict[str, bytes]) -> None:
    def interrupted(job: AttemptJob) -> AttemptPayload:
        if job.attempt == 3:
            raise KeyboardInterrupt
        return payload(job)

    with pytest.raises(InterruptedJobError, match=r"interrupted: [012] of 5 episodes"):
        recording.run(Inline(interrupted))
    recording.resume()
    assert tree(recording.path) == undisturbed


@pytest.mark.parametrize(("signals", "complete"), [(2, 1), (3, 0)])
def test_the_second_signal_waits_until_an_episode_and_its_ledger_line_are_written(
    recording: Recording,
    undisturbed: dict[str, bytes],
    monkeypatch: pytest.MonkeyPatch,
    signals: int,
    complete: int,
) -> None:
    log_attempt = DatasetWriter.log_attempt

    def interrupted(self: DatasetWriter, attempt: AttemptRecord) -> None:
        for _ in range(signals):
            os.kill(os.getpid(), signal.SIGTERM)
        log_attempt(self, attempt)

    monkeypatch.setattr(DatasetWriter, "log_attempt", interrupted)
    with (
        stop_on_signal("stopping") as recording.stop,
        pytest.raises(InterruptedJobError, match=f"interrupted: {complete} of 5 episodes are complete"),
    ):
        recording.run()
    # Even after the third signal, which comes before the ledger line, the episode is kept.
    assert [path.name for path in recording.path.glob("ep_*")] == ["ep_000000"]
    monkeypatch.undo()
    recording.stop = StopRequest()
    recording.resume()
    assert tree(recording.path) == undisturbed


def test_workers_that_draw_differently_are_mentioned(recording: Recording) -> None:
    recording.run(Inline(lambda job: replace(payload(job), renderer=f"driver {job.attempt % 2}")))
    assert any("Workers render with different OpenGL (driver" in warning for warning in recording.warnings)


def test_a_disk_without_room_is_refused_before_anything_is_made(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = SimpleNamespace(f_frsize=4096, f_bavail=9, f_files=0)
    monkeypatch.setattr("os.statvfs", lambda place: full)
    with pytest.raises(ResourceError, match=r"5 episodes take .* 0 fit"):
        recording.run()
    assert not recording.path.exists()
    monkeypatch.undo()
    recording.run()
    monkeypatch.setattr("os.statvfs", lambda place: full)
    # A complete dataset needs no space.
    recording.resume()


@pytest.mark.parametrize("wrist", [False, True])
def test_a_network_mount_is_warned_of_with_the_files_per_episode(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, wrist: bool
) -> None:
    mount = Mount(2, 1, PurePosixPath("/far"), "fuse.sshfs", "host:/x", frozenset())
    monkeypatch.setattr("yamsim_cli.recording.recording_output.network_mount", lambda path, mounts: mount)
    recording.config = recording.config.model_copy(update={"wrist": wrist})
    recording.run()
    (warning,) = recording.warnings
    task = recording.config.task
    files = math.ceil(typical_tick_count(task) / task.timing.ticks_per_frame) * (3 if wrist else 2)
    assert f"is on /far, which is fuse.sshfs (host:/x): an episode has {files} files" in warning
    recording.warnings.clear()
    recording.resume()
    assert "Every file in" in recording.warnings[1]


def test_locks_that_do_not_reach_others_are_told_apart(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    mount = Mount(2, 1, PurePosixPath("/far"), "fuse.sshfs", "host:/x", frozenset())
    recording.path.mkdir()
    (recording.path / ".lock").write_text('{"pid": 1, "host": "elsewhere"}')
    monkeypatch.setattr("yamsim_cli.recording.recording_output.network_mount", lambda path, mounts: mount)
    with pytest.raises(ResourceError, match="by process 1 on elsewhere"):
        recording.run()
    monkeypatch.undo()
    recording.run()
