"""Checking a dataset by worker processes."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.datasets.checks.sample import CAMERA, SampleDataset, episode, look
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.checks.context import EpisodeDirectory
from yamsim_cli.core.errors import DatasetError, InterruptedJobError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.datasets.checks.episode_facts import EpisodeFacts
from yamsim_cli.datasets.summarize import EpisodeChecker, check_dataset


@pytest.fixture
def dataset(tmp_path: Path, config: RecordConfig) -> Path:
    path = SampleDataset(config.data_config(), [episode(k) for k in range(4)]).write(tmp_path / "dataset")
    image = path / f"ep_000001/rgb/{CAMERA}/000002.jpg"
    data = image.read_bytes()
    image.write_bytes(data[:-300] + data[-2:])
    (path / "ep_000003/lowdim/000001.pkl").write_bytes(b"")
    return path


def test_workers_find_what_one_process_finds(
    dataset: Path, locations: Locations, capfd: pytest.CaptureFixture[str]
) -> None:
    told: list[tuple[int, int]] = []
    found = check_dataset(dataset, locations, 2, lambda *done: told.append(done))
    assert found.problems == look(dataset, locations).problems
    assert [problem.code for problem in found.problems] == ["image.decode", "lowdim.damaged"]
    assert [episode.name for episode in found.episodes] == [f"ep_{k:06d}" for k in range(4)]
    assert told == [(k, 4) for k in range(1, 5)]
    assert capfd.readouterr() == ("", "")


def test_an_interruption_is_an_interrupted_job_error(dataset: Path, locations: Locations) -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(InterruptedJobError, match="interrupted after 1 of 4 episodes; nothing was changed"):
        check_dataset(dataset, locations, 1, interrupt)


def test_no_worker_is_started_for_nothing(tmp_path: Path, locations: Locations, monkeypatch: Any) -> None:
    monkeypatch.setattr("yamsim_cli.datasets.summarize.ProcessPool", None)
    with pytest.raises(DatasetError):
        check_dataset(tmp_path, locations, 2, lambda *_: None)
    (tmp_path / "config.yaml").write_text("{}\n")
    found = check_dataset(tmp_path, locations, 2, lambda *_: None)
    assert {problem.code for problem in found.problems} == {"config.damaged", "dataset.empty"}


class CrashingChecker(EpisodeChecker):
    """Ends its process on one episode, as for a file that crashes a decoder."""

    def run(self, job: EpisodeDirectory) -> EpisodeFacts:
        if job.number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().run(job)


@pytest.mark.slow
def test_an_episode_that_ends_every_process_is_told_and_the_rest_is_checked(
    dataset: Path, locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("yamsim_cli.datasets.summarize.EpisodeChecker", CrashingChecker)
    found = check_dataset(dataset, locations, 2, lambda *_: None)
    assert [(problem.code, problem.episode) for problem in found.problems][:2] == [
        ("episode.unchecked", "ep_000001"),
        ("lowdim.damaged", "ep_000003"),
    ]
    assert "killed by SIGKILL" in found.problems[0].value
