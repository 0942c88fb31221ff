from __future__ import annotations

import functools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.core.workers.toy_runners import ToyRunner
from yamsim_cli.core.errors import PartialJobError, ResourceError, SimulationError
from yamsim_cli.core.workers import process_pool as workers
from yamsim_cli.core.workers.executors import LostJobError, WorkerBugError, run_all
from yamsim_cli.core.workers.job_server import kill_forks_at_exit
from yamsim_cli.core.workers.process_pool import ProcessPool


def _pool(workers: int = 1, job_seconds: float = 60.0) -> ProcessPool[int | str, object]:
    return ProcessPool(ToyRunner, workers, job_seconds)


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
        assert dict(run_all(pool, range(10))) == {k: k * k for k in range(10)}


def test_a_lost_job_gets_another_result_among_the_others() -> None:
    with _pool(2) as pool:
        jobs: list[int | str] = [1, "exit", 2]
        assert dict(run_all(pool, jobs, lambda lost: lost.reason)) == {1: 1, 2: 4, "exit": "ended with code 7"}
        with pytest.raises(LostJobError):
            list(run_all(pool, jobs))


def test_an_error_of_the_job_reaches_the_caller_as_it_is_and_the_worker_goes_on() -> None:
    with _pool() as pool:
        pool.submit("pid")
        before = pool.next_result()
        pool.submit("error")
        with pytest.raises(SimulationError, match="the toy is broken"):
            pool.next_result()
        pool.submit("pid")
        assert pool.next_result() == before


def test_a_bug_brings_its_own_traceback() -> None:
    with _pool() as pool:
        pool.submit("bug")
        with pytest.raises(WorkerBugError, match=r"on bug:(?s:.*)toy_runners(?s:.*)ZeroDivisionError: nobody expected"):
            pool.next_result()


def test_an_answer_that_cannot_travel_is_a_bug() -> None:
    with _pool() as pool:
        pool.submit("lambda")
        with pytest.raises(WorkerBugError, match="pickle"):
            pool.next_result()


@pytest.mark.parametrize("died_of", ["kill", "resting"])
def test_a_dead_worker_is_replaced_and_its_job_tried_again(tmp_path: Path, died_of: str) -> None:
    with _pool() as pool:
        pool.submit("pid")
        _, pid = pool.next_result()
        assert isinstance(pid, int)
        if died_of == "kill":
            pool.submit(f"once:{tmp_path / 'flag'}")
            assert pool.next_result()[1] == f"once:{tmp_path / 'flag'} again"
        else:
            os.kill(pid, signal.SIGKILL)
            assert _gone_within(pid, 10)
        pool.submit("pid")
        assert pool.next_result()[1] != pid


@pytest.mark.parametrize(
    ("job", "how"),
    [
        ("die", "was killed by SIGKILL, perhaps because memory ran out"),
        ("segfault", "was killed by SIGSEGV"),
        ("exit", "ended with code 7"),
        ("sleep", "was ended after 0.2 s without a result"),
        ("freeze", "was ended after 0.2 s without a result"),
    ],
)
def test_a_job_that_ends_every_worker_is_given_up_and_the_pool_goes_on(job: str, how: str) -> None:
    with _pool(2, job_seconds=0.2) as pool:
        pool.submit(job)
        with pytest.raises(LostJobError, match=rf"^{job} was given up after 3 tries: its worker {how}") as caught:
            pool.next_result()
        assert caught.value.job == job
        pool.submit(7)
        assert pool.next_result() == (7, 49)


def test_a_worker_that_stops_in_the_middle_of_its_answer_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "MESSAGE_TIMEOUT", 0.2)
    with _pool() as pool:
        pool.submit("half")
        with pytest.raises(LostJobError, match="was killed by SIGKILL"):
            pool.next_result()


def test_a_large_answer_arrives_whole() -> None:
    with _pool() as pool:
        pool.submit("large:30000000")
        assert pool.next_result()[1] == bytes(30_000_000)


def test_a_fork_of_a_worker_answers_for_nobody() -> None:
    """A fork made in the first job would answer a second time, which would count for the second job."""
    with _pool() as pool:
        for job, result in (("fork", "forked"), (3, 9), ("fork", "forked"), (4, 16)):
            pool.submit(job)
            assert pool.next_result() == (job, result)


def test_a_fork_that_exits_keeps_its_exit_code() -> None:
    with _pool() as pool:
        pool.submit("fork and exit")
        assert pool.next_result()[1] == 5


def test_answers_of_other_processes_and_for_other_jobs_are_refused() -> None:
    with _pool() as pool:
        for number in (1, 2):
            pool.submit(f"forge:{number}")
            assert pool.next_result()[1] == "true"


def test_leaving_ends_workers_in_the_middle_of_a_job() -> None:
    with _pool() as pool:
        pool.submit("pid")
        _, pid = pool.next_result()
        assert isinstance(pid, int)
        pool.submit("sleep")
    assert not _alive(pid)


def test_what_stops_the_parent_does_not_stop_a_worker() -> None:
    """Ctrl-C reaches the whole process group, SIGTERM a whole cluster job."""
    with _pool() as pool:
        pool.submit("pid")
        _, pid = pool.next_result()
        assert isinstance(pid, int)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(pid, number)
        pool.submit("pid")
        assert pool.next_result()[1] == pid


def test_a_worker_that_is_only_just_starting_is_deaf_to_ctrl_c() -> None:
    others = multiprocessing.active_children()
    with _pool() as pool:
        (worker,) = (child for child in multiprocessing.active_children() if child not in others)
        pid = worker.pid
        assert pid is not None
        os.kill(pid, signal.SIGINT)
        pool.submit("pid")
        assert pool.next_result()[1] == pid


def test_a_runner_that_cannot_be_made_is_reported() -> None:
    with ProcessPool[int, object](functools.partial(ToyRunner, "no argument", "too many"), 1) as pool:  # type: ignore[call-arg]
        pool.submit(1)
        with pytest.raises(WorkerBugError, match="TypeError"):
            pool.next_result()
    with ProcessPool[int, object](functools.partial(ToyRunner, "refuse"), 2) as pool:
        pool.submit(1)
        with pytest.raises(ResourceError, match=r"^no toys here$"):
            pool.next_result()


def test_workers_that_die_while_starting_are_not_replaced_for_ever() -> None:
    with ProcessPool[int, object](functools.partial(ToyRunner, "die"), 2) as pool:
        pool.submit(1)
        with pytest.raises(PartialJobError, match=r"do not start: .* the last one ended with code 9"):
            pool.next_result()


def _parent(tmp_path: Path, last_words: str) -> subprocess.Popen[str]:
    script = tmp_path / "parent.py"
    script.write_text(
        "from tests.core.workers.toy_runners import ToyRunner\n"
        "from yamsim_cli.core.workers.process_pool import ProcessPool\n"
        "if __name__ == '__main__':\n"
        "    pool = ProcessPool(ToyRunner, 1)\n"
        "    pool.submit('pid')\n"
        "    print(pool.next_result()[1], flush=True)\n"
        "    pool.submit('sleep')\n"
        f"    {last_words}\n"
    )
    return subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )


def test_workers_end_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    with _parent(tmp_path, "input()") as parent:
        assert parent.stdout
        pid = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        assert _gone_within(pid, 5)


def test_a_parent_that_forgets_its_workers_ends_all_the_same(tmp_path: Path) -> None:
    with _parent(tmp_path, "pass") as parent:
        assert parent.stdout
        pid = int(parent.stdout.readline())
        assert parent.wait(30) == 0
        assert not _alive(pid)


def _code(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.parametrize(("how", "code"), [("returns", 1), ("raises", 1), (None, 0), (3, 3), ("a word", 1)])
def test_a_forked_process_ends_with_its_own_exit_code(how: object, code: int) -> None:
    with kill_forks_at_exit():
        child = os.fork()
        if child == 0 and how == "raises":
            raise ValueError
        if child == 0 and how != "returns":
            sys.exit(how)  # type: ignore[arg-type]
    # Only the parent gets here.
    assert _code(child) == code


def test_this_process_is_not_ended() -> None:
    with kill_forks_at_exit():
        pass
    for error in (ValueError, SystemExit):
        with pytest.raises(error), kill_forks_at_exit():
            raise error
