"""A teleoperated recording that is killed, and continued by the next session."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.viewers.teleop.demonstrated import planned_lines, write_stream
from tests.viewers.teleop.test_teleop import play, run
from tests.viewers.teleop.tray import CollectingReceiver
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.viewers.teleop.recording_journal import RecordingJournal
from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene


def driven_in(
    folder: Path, config: RecordConfig, locations: Locations, **more: float
) -> tuple[TeleopScene, CollectingReceiver]:
    tray = CollectingReceiver()
    return TeleopScene(Session(config, locations), tray, RecordingJournal(folder), **more), tray


@pytest.fixture
def lines(config: RecordConfig, locations: Locations) -> list[dict[str, object]]:
    return planned_lines(config, locations, 0)


@pytest.mark.slow
def test_what_was_driven_before_a_kill_is_handed_in_as_if_it_had_been_stopped(
    config: RecordConfig, locations: Locations, tmp_path: Path, lines: list[dict[str, object]]
) -> None:
    killed, _ = driven_in(tmp_path, config, locations)
    play(killed, lines[:-1], tmp_path)
    # The same, stopped there by a session that is not killed.
    (tmp_path / "other").mkdir()
    living, tray = driven_in(tmp_path / "other", config, locations)
    play(living, lines[:-1], tmp_path)
    living.stop_recording()
    living.settle()

    (left,) = RecordingJournal(tmp_path).unfinished_recordings()
    assert left.stopped is None
    following, taken = driven_in(tmp_path, config, locations)
    following.submit_unfinished(left)
    (stopped,), (found,) = tray.attempts, taken.attempts
    assert found.attempt.job == stopped.attempt.job
    assert found.attempt.object_places == stopped.attempt.object_places
    assert np.array_equal(found.attempt.start, stopped.attempt.start)
    n = len(left.ticks)
    assert len(taken.actions.ctrl) == len(tray.actions.ctrl)
    assert np.array_equal(taken.actions.ctrl[:n], tray.actions.ctrl[:n])
    assert np.array_equal(taken.actions.magnet, tray.actions.magnet)
    # Then the arm stands still, where that of the other session still slows down.
    assert np.allclose(taken.actions.joints[n:], tray.actions.joints[n:], atol=0.1)


def test_a_recording_killed_while_it_came_to_rest_rests_as_long(
    config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    killed, _ = driven_in(tmp_path, config, locations)
    killed.start_recording()
    run(killed, 1.0)
    killed.stop_recording()
    run(killed, 0.32)
    (left,) = RecordingJournal(tmp_path).unfinished_recordings()
    assert (len(left.ticks), left.stopped) == (41, 31)
    following, tray = driven_in(tmp_path, config, locations)
    following.submit_unfinished(left)
    assert len(tray.actions.ctrl) == 31 + config.task.timing.settle_ticks + config.task.hold_ticks


def test_the_file_goes_with_its_recording(config: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    driven, _ = driven_in(tmp_path, config, locations)
    run(driven, 0.1)
    assert RecordingJournal(tmp_path).unfinished_recordings() == []
    driven.start_recording()
    run(driven, 0.1)
    driven.discard_recording()
    assert list(tmp_path.iterdir()) == []
    driven.start_recording()
    run(driven, 0.1)
    driven.stop_recording()
    driven.settle()
    # Submitted, and not yet in the dataset.
    journal = RecordingJournal(tmp_path)
    assert len(journal.unfinished_recordings()) == 1
    journal.delete_recording(0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("cut", "ticks"), [(1, 10), (30, 9)])
def test_a_file_that_is_cut_off_is_read_as_far_as_it_goes(
    cut: int, ticks: int, config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    driven, _ = driven_in(tmp_path, config, locations)
    driven.start_recording()
    run(driven, 0.32)
    (file,) = (tmp_path / ".recordings").iterdir()
    file.write_bytes(file.read_bytes()[:-cut])
    (left,) = RecordingJournal(tmp_path).unfinished_recordings()
    assert len(left.ticks) == ticks


def test_a_journal_without_a_beginning_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".recordings").mkdir()
    (tmp_path / ".recordings" / "000000.jsonl").write_bytes(b'{"seed": 0')
    assert RecordingJournal(tmp_path).unfinished_recordings() == []
    assert not list((tmp_path / ".recordings").iterdir())


def test_a_recording_ends_at_its_limit(config: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    driven, tray = driven_in(tmp_path, config, locations, time_limit=1.0)
    driven.start_recording()
    run(driven, 0.9)
    assert driven.is_recording
    run(driven, 0.2)
    assert "stopped after 1 s" in driven.status.message
    driven.settle()
    assert len(tray.actions.ctrl) == 31 + config.task.timing.settle_ticks + config.task.hold_ticks
    assert not driven.is_recording


def test_a_recording_is_paused_when_its_page_is_closed(
    config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    driven, _ = driven_in(tmp_path, config, locations)
    driven.pause_unattended()
    assert not driven.paused, "nothing is recorded that could go on unseen"
    driven.start_recording()
    run(driven, 0.32)
    driven.pause_unattended()
    before = driven.status.seconds
    run(driven, 1.0)
    assert driven.status.seconds == before
    assert driven.status.message == "paused, because no browser was connected; click Play to continue"
    driven.paused = False
    run(driven, 0.32)
    assert driven.status.seconds > before


@pytest.mark.render
@pytest.mark.slow
def test_a_killed_session_is_judged_on_resume(
    config: RecordConfig, locations: Locations, tmp_path: Path, repository: Path
) -> None:
    """`kill -9` late in a demonstration: the next session finds the object on its target."""
    lines = planned_lines(config, locations, 0)
    # It never stops, and waits long enough to be killed.
    stream = write_stream(tmp_path / "stream.jsonl", [*lines[:-1], {"t": 500.0}])
    out, flags = tmp_path / "driven", ("--quality", "fast", "--size", "64x48")
    process = subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", "teleop", "--input", str(stream), "--out", str(out), *flags],
        env={**os.environ, "PYTHONPATH": str(repository)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wanted = len(lines) + 200
    end = time.monotonic() + 120
    while time.monotonic() < end:
        files = list((out / ".recordings").glob("*.jsonl"))
        if files and files[0].read_bytes().count(b"\n") > 2 * wanted:
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    told = json.loads(yamsim("summarize", str(out), "--json").out)
    assert [problem["code"] for problem in told["problems"] if problem["code"].startswith("leftover")]

    nothing = write_stream(tmp_path / "nothing.jsonl", [{"t": 0.0}])
    done = yamsim("teleop", "--input", str(nothing), "--out", str(out), "--resume", "--json", *flags)
    assert done.code == 0, done.err
    assert "A killed session left attempt " in done.err
    assert json.loads(done.out)["episodes"] == 1
    assert not (out / ".recordings").exists()
    verified = yamsim("verify", str(out), "--json")
    assert (verified.code, json.loads(verified.out)["max_error"]) == (0, 0)
