from __future__ import annotations

import errno
import os
import shutil
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.core.dataset.making import tree
from tests.recording.fake_episodes import Inline, Recording
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.records import AttemptRecord, EpisodeRecord
from yamsim_cli.core.dataset.writing import staged_writer as stage_module
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import InterruptedJobError, PartialJobError, ResourceError
from yamsim_cli.core.workers.stop_request import StopRequest

Make = Callable[..., RecordConfig]


@pytest.fixture
def recording(make_config: Make, tmp_path: Path) -> Recording:
    return Recording(make_config({("episodes",): 5, ("seed",): 1}), tmp_path / "dataset", tmp_path / "stage")


@pytest.fixture
def undisturbed(make_config: Make, tmp_path: Path) -> dict[str, bytes]:
    one = Recording(make_config({("episodes",): 5, ("seed",): 1}), tmp_path / "undisturbed")
    one.run()
    return tree(one.path)


class Target:
    """Lets a number of episodes into the dataset, then refuses or blocks them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room = 0
        self.refuse = True
        self.open = threading.Event()
        self.reached = threading.Event()
        real = DatasetWriter.publish_episode

        def publish(writer: DatasetWriter, record: EpisodeRecord, files: Mapping[str, bytes]) -> None:
            self.room -= 1
            if self.room < 0 and self.refuse:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if self.room < 0:
                self.reached.set()
                assert self.open.wait(30)
            real(writer, record, files)

        monkeypatch.setattr(DatasetWriter, "publish_episode", publish)


@pytest.fixture
def target(monkeypatch: pytest.MonkeyPatch) -> Target:
    return Target(monkeypatch)


def waiting(recording: Recording) -> list[str]:
    """Episodes that are in the stage."""
    assert recording.stage
    return sorted(path.name for path in recording.stage.glob("*/ep_*"))


def keep_all_in_the_stage(recording: Recording, target: Target, room: int = 0) -> None:
    """Record while the target accepts at most `room` episodes, and stop before the rest has arrived."""
    target.room, target.refuse = room, False
    stop = recording.stop

    def blocked() -> None:
        target.reached.wait(30)
        stop.request_stop()

    waiter = threading.Thread(target=blocked)
    waiter.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage_module, "HALT_SECONDS", 0.1)
        with pytest.raises(InterruptedJobError):
            recording.run()
    waiter.join()
    recording.stop = StopRequest()


def test_what_passes_through_a_stage_is_the_same(recording: Recording, undisturbed: dict[str, bytes]) -> None:
    report = recording.run()
    assert (report.episodes, report.attempts) == (5, 7)
    assert tree(recording.path) == undisturbed
    assert recording.stage
    assert list(recording.stage.iterdir()) == []


def test_a_target_that_refuses_keeps_the_rest_in_the_stage(
    recording: Recording, undisturbed: dict[str, bytes], target: Target
) -> None:
    target.room = 2
    with pytest.raises(PartialJobError) as caught:
        recording.run()
    kept = waiting(recording)
    assert kept
    assert "no space left on the device" in str(caught.value)
    assert f"({len(kept)} of them still in {recording.stage}/dataset-" in str(caught.value)
    assert sorted(path.name for path in recording.path.glob("ep_*")) == ["ep_000000", "ep_000001"]
    target.room = 99
    executor = Inline()
    recording.resume(executor)
    assert len(executor.made) <= 7 - 3 - len(kept), "what is in the stage is not made again"
    assert tree(recording.path) == undisturbed
    assert waiting(recording) == []


@pytest.mark.slow
@pytest.mark.parametrize("fate", ["kept", "lost", "not given", "damaged", "cut off", "unlogged"])
def test_whatever_becomes_of_the_stage_the_bytes_are_the_same(
    recording: Recording, undisturbed: dict[str, bytes], target: Target, fate: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    target.room = 1
    with pytest.raises(PartialJobError):
        recording.run()
    monkeypatch.undo()
    assert recording.stage
    folder = next(recording.stage.iterdir())
    ledger = folder / "attempts.jsonl"
    match fate:
        case "lost":
            shutil.rmtree(recording.stage)
        case "not given":
            recording.stage = None
        case "damaged":
            next(folder.glob("ep_*/lowdim/*")).write_bytes(b"")
        case "cut off":
            ledger.write_bytes(ledger.read_bytes()[:-9])
        case "unlogged":
            ledger.write_bytes(b"")
    recording.resume()
    assert tree(recording.path) == undisturbed
    if fate == "not given":
        recording.stage = folder.parent
        recording.resume()
        assert list(recording.stage.iterdir()) == []
        assert tree(recording.path) == undisturbed


def test_a_user_who_does_not_wait_for_the_rest_finds_it_in_the_stage(
    recording: Recording, undisturbed: dict[str, bytes], target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_all_in_the_stage(recording, target)
    assert len(waiting(recording)) == 5
    # As after the end of that process: its mover hangs forever.
    monkeypatch.undo()
    executor = Inline()
    recording.resume(executor)
    assert executor.made == []
    assert tree(recording.path) == undisturbed
    target.open.set()


def test_a_target_that_does_not_answer_does_not_hold_the_end_up(
    recording: Recording, target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    touched: list[str] = []
    monkeypatch.setattr(DatasetWriter, "write_manifest", lambda writer: touched.append("finish"))
    keep_all_in_the_stage(recording, target)
    assert touched == []
    target.open.set()


def test_the_number_of_staged_episodes_is_limited(
    recording: Recording, undisturbed: dict[str, bytes], target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage_module, "MAX_WAITING", 1)
    target.refuse = False
    most: list[int] = []

    def release() -> None:
        target.reached.wait(30)
        # Long enough for all five if nothing blocked them.
        threading.Event().wait(1.0)
        most.append(len(waiting(recording)))
        target.open.set()

    thread = threading.Thread(target=release)
    thread.start()
    recording.run()
    thread.join()
    assert most[0] <= 3, "one being moved, one in the queue, one at its door"
    assert tree(recording.path) == undisturbed


def test_a_stage_of_another_recording_is_moved_not_thrown_away(
    recording: Recording, target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    target.room = 0
    with pytest.raises(PartialJobError):
        recording.run()
    monkeypatch.undo()
    kept = waiting(recording)
    recording.config = recording.config.model_copy(update={"seed": 2})
    recording.run(mode=ExistingDatasetMode.OVERWRITE)
    assert recording.stage
    (moved,) = recording.stage.iterdir()
    assert sorted(path.name for path in moved.glob("ep_*")) == kept
    assert any(
        f"The staging directory held episodes of another recording: they are now in {moved}" in w
        for w in recording.warnings
    )


def test_several_datasets_can_share_a_stage(recording: Recording, tmp_path: Path, target: Target) -> None:
    target.room = 0
    with pytest.raises(PartialJobError):
        recording.run()
    kept = waiting(recording)
    target.room = 99
    other = Recording(recording.config, tmp_path / "other" / "dataset", recording.stage)
    other.run()
    assert waiting(recording) == kept


def test_a_stage_that_cannot_be_used_is_named(recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "stage").write_text("a file")
    with pytest.raises(
        ResourceError, match=r"the staging directory .*/stage/dataset-.* cannot be used: .* another --stage"
    ):
        recording.run()
    recording.stage = None
    recording.resume()


def test_a_bug_in_the_mover_does_not_go_unheard(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(writer: DatasetWriter, attempt: AttemptRecord) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(DatasetWriter, "log_attempt", broken)
    with pytest.raises(ZeroDivisionError):
        recording.run()
