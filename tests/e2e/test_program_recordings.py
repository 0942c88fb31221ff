"""Recordings of program tasks: killed and resumed, and reproduced bit for bit."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.e2e.recorder import digest, episodes, run, start, wait_until
from tests.programs import ONTO_PLATE, written
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.datasets.verify import CHECK_NAMES, EpisodeVerifier, Tolerances
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import inline_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput
from yamsim_cli.session_opener import SessionOpener

pytestmark = [pytest.mark.render, pytest.mark.slow]

# One of the folds, which take a minute each.
NAMES = Locations.from_environment(os.environ).config_names("tasks")
SHIPPED = [name for name in NAMES if not name.startswith("fold_") or name == "fold_napkin"]


@pytest.fixture(scope="module")
def flags(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Flags of a small task, whose four episodes use both casts."""
    task = written(tmp_path_factory.mktemp("task"), ONTO_PLATE)
    return ("--task", str(task), "--n", "4")


@pytest.fixture(scope="module")
def undisturbed(flags: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("data") / "undisturbed"
    assert run(out, *flags, "--workers", "1") == (0, "")
    return digest(out)


def test_kill_and_resume_give_what_an_undisturbed_run_gives(
    flags: tuple[str, ...], undisturbed: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "killed"
    with start(out, *flags, "--workers", "2") as process:
        wait_until(lambda: episodes(out))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    assert 0 < len(episodes(out)) < 4
    assert run(out, *flags, "--workers", "2", "--resume") == (0, "")
    assert digest(out) == undisturbed


@pytest.mark.parametrize("task", SHIPPED)
def test_each_shipped_task_is_made_again_bit_for_bit(task: str, locations: Locations, tmp_path: Path) -> None:
    opener = SessionOpener(os.environ, lambda text: None, lambda setting: f"--{setting}")
    config = opener.load_record_config("default", locations, task=task, n=1, workers=1, size="32x24", quality="fast")
    session = Session(config, locations).without_meshes()
    out = tmp_path / "dataset"
    watch = RecordCallbacks(lambda done, wanted, attempts: None, lambda text: None)
    record(session, RecordingOutput(out, ExistingDatasetMode.NEW), inline_executor, watch, StopRequest())
    with EpisodeVerifier(session, Tolerances(0.0, 0.0)) as verifier:
        verdict = verifier.run((0, out / "ep_000000"))
    assert verdict.is_reproduced, verdict
    assert set(verdict.checks) == set(CHECK_NAMES)
    assert all(largest == 0 for check in verdict.checks.values() for largest in check.largest.values())
