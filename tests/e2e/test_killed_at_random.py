"""SIGKILL at random moments, repeatedly: the final recording equals an undisturbed one."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest

from tests.e2e.recorder import digest, is_alive, run, start, wait_until, workers_of
from yamsim_cli.core.dataset.writing.integrity import inspect_episodes

pytestmark = [pytest.mark.render, pytest.mark.slow]

KILLS = 8
FLAGS = ("--n", "6", "--workers", "2")


def test_kills_lose_no_episode(tmp_path: Path) -> None:
    undisturbed, path = tmp_path / "undisturbed", tmp_path / "killed"
    assert run(undisturbed, *FLAGS) == (0, "")
    seed = int(os.environ.get("YAMSIM_TEST_KILL_SEED", time.time_ns()))
    print(f"again with YAMSIM_TEST_KILL_SEED={seed}")
    rng = random.Random(seed)

    kills = {"recorder": 0, "worker": 0}
    ended = 0
    began = time.monotonic()
    while sum(kills.values()) < KILLS:
        with start(path, *FLAGS, "--resume") as process:
            # Half of the kills hit the start and the opening of the dataset.
            time.sleep(rng.uniform(0, 2) if rng.random() < 0.5 else rng.uniform(2, 8))
            workers = workers_of(process.pid)
            victim = rng.choice(["recorder", "worker"]) if workers else "recorder"
            if process.poll() is None:
                os.kill(process.pid if victim == "recorder" else rng.choice(workers), signal.SIGKILL)
                kills[victim] += 1
            if victim == "worker":
                # The recorder goes on until it is killed.
                time.sleep(rng.uniform(0, 4))
                if process.poll() is None:
                    process.kill()
                    kills["recorder"] += 1
            process.wait()
            ended += process.returncode == 0
        wait_until(lambda workers=workers: not any(map(is_alive, workers)), seconds=10)
        assert [found.fault for found in inspect_episodes(path) if found.fault] == [] if path.exists() else True
        if process.returncode == 0:
            # After the last episode, start again, so that every kill hits a recording.
            assert digest(path) == digest(undisturbed)
            path.rename(tmp_path / f"whole-{ended}")
    code, err = run(path, *FLAGS, "--resume")
    assert code == 0, err
    assert digest(path) == digest(undisturbed)
    print(
        f"kills: {kills}, recordings finished: {ended + 1}, seconds: {time.monotonic() - began:.0f}, episodes lost: 0"
    )
