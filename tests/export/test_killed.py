"""A killed export publishes all episodes or none, and the next export removes what the killed one left."""

from __future__ import annotations

import os
import random
import shutil
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
LATEST_KILL_S = 1.5  # after the first file of an episode; a fast machine may finish its export earlier

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
    out = tmp_path / "out"
    for delay_s in (0.0, random.Random(name).uniform(0, LATEST_KILL_S)):
        running = begin(words, recorded, out)
        until = time.monotonic() + PATIENCE_S
        before = set(parts(tmp_path))
        while not any(any(part.iterdir()) for part in set(parts(tmp_path)) - before):
            assert time.monotonic() < until and running.poll() is None
            time.sleep(0.01)
        time.sleep(delay_s)
        os.kill(running.pid, signal.SIGKILL)
        running.wait()
        if out.exists():  # the export was published before the signal arrived
            assert len(format_reader(kind)(out, station, None, locations)) == EPISODES
            shutil.rmtree(out)
        assert all(path.name.startswith(".") for path in tmp_path.iterdir())
    assert begin(words, recorded, out).wait(PATIENCE_S) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert len(format_reader(kind)(out, station, None, locations)) == EPISODES
