"""The disk space that `record` requires before it starts, for program tasks."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from yamsim_cli.api import API_SESSION_OPENER, record
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.expert.skills.program import typical_tick_count
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.recording_output import RecordingOutput, open_destination

# Frames of one recorded episode: `yamsim record --task TASK --n 1 --seed 0 --size 64x48 --quality fast`.
RECORDED_FRAMES = {
    "cans_into_bin": 178,
    "drawer": 253,
    "fold_napkin": 100,
    "fold_napkin_crumpled": 202,
    "fold_napkin_diagonal": 118,
    "fold_napkin_thirds": 177,
    "hand_over_and_place": 149,
    "handover": 147,
    "hang_mug": 105,
    "lift_tray": 57,
    "onto_napkin": 101,
    "pickplace": 84,
    "set_upright": 102,
    "sort_row": 258,
    "swap": 295,
    "tower": 151,
}


def config_of(task: str) -> RecordConfig:
    return API_SESSION_OPENER.open("default", parallel=False, task=task, n=3, size=(64, 48), quality="fast").config


@pytest.mark.parametrize(
    "task", [pytest.param(task, marks=[pytest.mark.slow] if "fold" in task else []) for task in RECORDED_FRAMES]
)
def test_a_programs_typical_duration_is_near_what_was_recorded(task: str) -> None:
    program = config_of(task).task
    frames = typical_tick_count(program) / program.timing.ticks_per_frame
    assert 0.7 < frames / RECORDED_FRAMES[task] < 2


def test_a_task_as_data_starts_on_a_disk_that_has_room_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Source: three episodes of `tower` took 9.1 MB and 2193 files."""
    disk = SimpleNamespace(f_frsize=4096, f_bavail=14_000_000 // 4096, f_files=10_000, f_favail=3_000)
    monkeypatch.setattr(os, "statvfs", lambda place: disk)
    told: list[str] = []
    watch, config = RecordCallbacks(lambda *_: None, told.append), config_of("tower")
    with open_destination(config, RecordingOutput(tmp_path / "fits", ExistingDatasetMode.NEW), watch):
        assert told == []
    disk.f_bavail = 8_000_000 // 4096
    with open_destination(config, RecordingOutput(tmp_path / "tight", ExistingDatasetMode.NEW), watch):
        assert "probably" in told[0]
    disk.f_bavail = 4_000_000 // 4096
    full = open_destination(config, RecordingOutput(tmp_path / "full", ExistingDatasetMode.NEW), watch)
    with pytest.raises(ResourceError, match="3 episodes take at least"), full:
        pass


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("task", ["tower", "lift_tray"])
def test_what_is_recorded_takes_about_the_room_that_was_estimated(
    task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "d", 1, seed=3, task=task, size=(64, 48), quality="fast")
    episode = tmp_path / "d" / "ep_000000"
    real = len(list(episode.rglob("*")))
    # Inodes of 0.7 and 2 episodes: the estimate lies between.
    for inodes, fits in ((2 * real, True), (real * 7 // 10, False)):
        disk = SimpleNamespace(f_frsize=4096, f_bavail=10**9, f_files=10**6, f_favail=inodes)
        told: list[str] = []
        watch = RecordCallbacks(lambda *_: None, told.append)
        config = config_of(task).model_copy(update={"episodes": 1})
        with monkeypatch.context() as patched:
            patched.setattr(os, "statvfs", lambda place, disk=disk: disk)
            with open_destination(config, RecordingOutput(tmp_path / str(inodes), ExistingDatasetMode.NEW), watch):
                assert (told == []) is fits
