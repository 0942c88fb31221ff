from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.core.jobs.toy_runners import Toy
from yamsim_cli.core.errors import PartialJobError, SimulationError
from yamsim_cli.core.jobs.workers import WorkerBugError, WorkerPool


def _pool(workers: int = 1) -> WorkerPool[int | str, object]:
    return WorkerPool(Toy, workers)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except FileNotFoundError:
        return False


def _gone_within(pid: int, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not _alive(pid):
            return True
        time.sleep(0.02)
    return False


def test_every_job_comes_back_with_its_result() -> None:
    with _pool(2) as pool:
        waiting, results = list(range(10)), {}
        while len(results) < 10:
            while pool.idle and waiting:
                pool.submit(waiting.pop(0))
            job, result = pool.result()
            results[job] = result
    assert results == {k: k * k for k in range(10)}


def test_work_is_done_in_other_processes() -> None:
    with _pool() as pool:
        pool.submit("pid")
        _, pid = pool.result()
        assert pid != os.getpid()


def test_idle_and_in_flight_add_up() -> None:
    with _pool(3) as pool:
        assert (pool.idle, pool.in_flight) == (3, 0)
        pool.submit(3)
        assert (pool.idle, pool.in_flight) == (2, 1)
        pool.result()
        assert (pool.idle, pool.in_flight) == (3, 0)


def test_an_error_of_the_job_reaches_the_caller_as_it_is() -> None:
    with _pool() as pool:
        pool.submit("error")
        with pytest.raises(SimulationError, match="the toy is broken"):
            pool.result()


def test_a_bug_brings_its_own_traceback() -> None:
    with _pool() as pool:
        pool.submit("bug")
        with pytest.raises(WorkerBugError, match=r"on bug:(?s:.*)toy_runners(?s:.*)ZeroDivisionError: nobody expected"):
            pool.result()


@pytest.mark.parametrize(("job", "how"), [("die", "killed by SIGKILL"), ("exit", "ended with code 7")])
def test_a_dead_worker_is_reported_with_its_job(job: str, how: str) -> None:
    with _pool(2) as pool:
        pool.submit(job)
        with pytest.raises(PartialJobError, match=f"{how} on {job}"):
            pool.result()


def test_leaving_ends_workers_in_the_middle_of_a_job() -> None:
    with _pool() as pool:
        pool.submit("pid")
        _, pid = pool.result()
        assert isinstance(pid, int)
        pool.submit("sleep")
    assert not _alive(pid)


def test_a_runner_that_cannot_be_made_is_reported() -> None:
    with WorkerPool[int, object](functools.partial(Toy, "no argument", "too many"), 1) as pool:  # type: ignore[arg-type]
        pool.submit(1)
        with pytest.raises(WorkerBugError, match="TypeError"):
            pool.result()


def test_workers_end_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "from tests.core.jobs.toy_runners import Toy\n"
        "from yamsim_cli.core.jobs.workers import WorkerPool\n"
        "if __name__ == '__main__':\n"
        "    pool = WorkerPool(Toy, 1)\n"
        "    pool.submit('pid')\n"
        "    print(pool.result()[1], flush=True)\n"
        "    input()\n"
    )
    root = Path(__file__).parents[3]
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
    ) as parent:
        assert parent.stdout
        pid = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        assert _gone_within(pid, 5)
