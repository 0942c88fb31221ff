"""An export that is killed at any moment leaves nothing under its name, and the next one removes its remains."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.export.station_datasets import motion_at, station_dataset
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.recordings.motion_reading import format_reader

pytestmark = pytest.mark.slow

EPISODES = 12
PATIENCE_S = 60.0
LATEST_KILL_S = 1.5  # after the first episode's folder; a whole export takes longer

FORMATS = {
    "maker": (["maker"], "maker"),
    "release": (["abc"], "mcap"),
    "training": (["abc", "--layout", "training"], "abc_training"),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Path:
    motions = [motion_at(station, 60) for _ in range(EPISODES)]
    return station_dataset(tmp_path_factory.mktemp("killed"), motions, station, locations)


def begin(words: list[str], recorded: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "yamsim_cli", "export", *words, str(recorded), str(out), "--workers", "2"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def parts(folder: Path) -> list[Path]:
    return list(folder.glob(".out.*.part"))


@pytest.mark.parametrize("name", FORMATS)
def test_a_killed_export_leaves_nothing_half_visible(
    name: str, recorded: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    words, kind = FORMATS[name]
    out, moment = tmp_path / "out", random.Random(name)
    for _ in range(2):
        running = begin(words, recorded, out)
        until = time.monotonic() + PATIENCE_S
        before = set(parts(tmp_path))
        while not any(any(part.iterdir()) for part in set(parts(tmp_path)) - before):
            assert time.monotonic() < until and running.poll() is None
            time.sleep(0.01)
        time.sleep(moment.uniform(0, LATEST_KILL_S))
        os.kill(running.pid, signal.SIGKILL)
        running.wait()
        assert not out.exists()
        assert all(path.name.startswith(".") for path in tmp_path.iterdir())
    assert begin(words, recorded, out).wait(PATIENCE_S) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert len(format_reader(kind)(out, station, None, locations)) == EPISODES
