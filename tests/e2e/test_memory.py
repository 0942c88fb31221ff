"""Memory of a recorder and its workers per episode."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.core.workers.toy_runners import ToyRunner
from tests.e2e.recorder import workers_of
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.workers.process_pool import ProcessPool
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import process_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput

# MB, that 2,000 episodes may add to any process.
LIMIT_MB = 50.0
EPISODES = 2000


def resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.render
@pytest.mark.long
@pytest.mark.slow
def test_two_thousand_episodes_fit_into_memory(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    """The growth from episode 60 to 180, times 17."""
    config = make_config(
        {
            ("image", "size_px"): [16, 16],
            ("task", "timing", "ticks_per_frame"): 57,
            ("episodes",): 180,
            ("workers",): 2,
        }
    )
    used: dict[int, dict[int, float]] = {}

    def measure(done: int, wanted: int, attempts: int) -> None:
        # Several episodes may arrive at once.
        mark = 180 if done >= 180 else 60
        if done >= 60 and mark not in used:
            used[mark] = {pid: resident_mb(pid) for pid in (os.getpid(), *workers_of(os.getpid()))}

    watch = RecordCallbacks(measure, lambda warning: None)
    record(
        Session(config, locations),
        RecordingOutput(tmp_path / "d", ExistingDatasetMode.NEW),
        process_executor,
        watch,
        StopRequest(),
    )
    assert len(used[180]) == 3
    growth = {pid: (used[180][pid] - used[60][pid]) * EPISODES / 120 for pid in used[180]}
    print({pid: f"{used[180][pid]:.0f} MB, {mb:.1f} MB more in {EPISODES} episodes" for pid, mb in growth.items()})
    assert max(growth.values()) < LIMIT_MB


@pytest.mark.slow
def test_large_answers_leave_nothing_behind() -> None:
    """Episodes of full size, as bytes through the pipe."""
    with ProcessPool[int | str, object](ToyRunner, 1) as pool:
        used = []
        for k in range(400):
            pool.submit(f"large:{3_000_000 + 5000 * (k % 97)}")
            assert pool.next_result()[1]
            if k in (100, 399):
                used.append([resident_mb(pid) for pid in (os.getpid(), *workers_of(os.getpid()))])
    before, after = used
    assert max(b - a for a, b in zip(before, after, strict=True)) < 20.0
