"""Rules of the worker pool, on scripted workers with a controlled clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.workers import worker_pool as pool_module
from yamsim_cli.core.workers.executors import LostJobError
from yamsim_cli.core.workers.worker_pool import (
    START_TIMEOUT,
    BaseWorkerPool,
    JobFailed,
    JobFinished,
    WorkerDied,
    WorkerEvent,
    WorkerReady,
)


@dataclass
class FakeWorker:
    name: str
    jobs: list[str] = field(default_factory=list)
    killed: bool = False
    deaf: bool = False

    def send(self, job: str) -> None:
        if self.deaf:
            raise BrokenPipeError
        self.jobs.append(job)

    def kill(self) -> None:
        self.killed = True


class FakeBackend:
    """A scripted backend: `script` holds (worker's number, event) for each poll, and its duration."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.puppets: list[FakeWorker] = []
        self.script: list[tuple[float, list[tuple[int, WorkerEvent[str]]]]] = []
        self.now = 0.0
        monkeypatch.setattr(pool_module, "time", SimpleNamespace(monotonic=lambda: self.now))

    def start(self, number: int) -> FakeWorker:
        self.puppets.append(FakeWorker(f"puppet-{number}"))
        return self.puppets[-1]

    def wait(self, workers: Sequence[FakeWorker], timeout: float) -> list[tuple[FakeWorker, WorkerEvent[str]]]:
        seconds, events = self.script.pop(0) if self.script else (timeout, [])
        self.now += seconds
        return [(self.puppets[k], event) for k, event in events if self.puppets[k] in workers]

    def close(self) -> None:
        return

    def hear(self, *events: tuple[int, WorkerEvent[str]]) -> None:
        self.script.append((0.0, list(events)))


@pytest.fixture
def theatre(monkeypatch: pytest.MonkeyPatch) -> FakeBackend:
    return FakeBackend(monkeypatch)


def listen(pool: BaseWorkerPool[str, str]) -> None:
    """Hear the whole script."""
    with pytest.raises(TimeoutError):
        pool.next_result(1e-3)


def test_a_lost_job_is_tried_three_times_each_on_a_new_worker(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 1) as pool:
        pool.submit("a")
        for k in range(3):
            theatre.hear((k, WorkerReady()))
            theatre.hear((k, WorkerDied("fell over")))
        with pytest.raises(LostJobError, match="its worker fell over"):
            pool.next_result()
        assert [puppet.jobs for puppet in theatre.puppets] == [["a"], ["a"], ["a"], []]
        assert (pool.idle, pool.in_flight) == (1, 0)


def test_the_last_try_is_made_alone(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 2) as pool:
        theatre.hear((0, WorkerReady()), (1, WorkerReady()))
        pool.submit("a")
        pool.submit("b")
        theatre.hear((0, WorkerDied("x")))
        theatre.hear((2, WorkerReady()))
        theatre.hear((2, WorkerDied("x")))
        theatre.hear((3, WorkerReady()))
        listen(pool)
        assert theatre.puppets[3].jobs == [], "b is still at work"
        assert pool.idle == 0, "nothing else may begin"
        theatre.hear((1, JobFinished("B")))
        assert pool.next_result() == ("b", "B")
        listen(pool)
        assert [puppet.jobs for puppet in theatre.puppets] == [["a"], ["b"], ["a"], ["a"]]
        assert pool.idle == 0
        theatre.hear((3, JobFinished("A")))
        assert pool.next_result() == ("a", "A")
        assert pool.idle == 2


def test_deaths_before_a_worker_is_ready_are_no_jobs_fault(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 1) as pool:
        pool.submit("a")
        for k in (0, 1):
            theatre.hear((k, WorkerDied("x")))
        theatre.hear((2, WorkerReady()))
        theatre.hear((2, WorkerDied("x")))
        for k in (3, 4):
            theatre.hear((k, WorkerDied("x")))
        theatre.hear((5, WorkerReady()))
        theatre.hear((5, JobFinished("A")))
        assert pool.next_result() == ("a", "A")


def test_a_worker_that_does_not_start_is_given_up_and_the_rest_go_on(theatre: FakeBackend) -> None:
    """For example because its node is gone; the others get its jobs."""
    with BaseWorkerPool[str, str](theatre, 2) as pool:
        theatre.hear((0, WorkerReady()))
        pool.submit("a")
        pool.submit("b")
        for k in (1, 2, 3):
            theatre.hear((k, WorkerDied("x")))
        theatre.hear((0, JobFinished("A")))
        assert pool.next_result() == ("a", "A")
        theatre.hear((0, JobFinished("B")))
        assert pool.next_result() == ("b", "B")
        assert pool.idle == 1
        assert len(theatre.puppets) == 4


def test_a_worker_that_hangs_is_ended_and_replaced(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 1, job_seconds=10) as pool:
        theatre.hear((0, WorkerReady()))
        pool.submit("a")
        listen(pool)
        with pytest.raises(TimeoutError):
            pool.next_result(9)
        assert not theatre.puppets[0].killed
        with pytest.raises(TimeoutError):
            pool.next_result(2)
        assert theatre.puppets[0].killed
        theatre.hear((1, WorkerReady()))
        listen(pool)
        assert theatre.puppets[1].jobs == ["a"]


def test_starting_has_a_limit_of_its_own_and_does_not_count_on_the_job(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 1, job_seconds=10) as pool:
        pool.submit("a")
        with pytest.raises(TimeoutError):
            pool.next_result(START_TIMEOUT - 1)
        theatre.hear((0, WorkerReady()))
        with pytest.raises(TimeoutError):
            pool.next_result(9)
        theatre.hear((0, JobFinished("A")))
        assert pool.next_result() == ("a", "A")

        theatre.puppets[0].deaf = True
        pool.submit("b")
        theatre.hear((0, WorkerDied("x")))
        listen(pool)
        with pytest.raises(TimeoutError):
            pool.next_result(START_TIMEOUT + 1)
        assert theatre.puppets[1].killed
        theatre.hear((2, WorkerReady()))
        listen(pool)
        assert theatre.puppets[2].jobs == ["b"]


def test_time_in_which_everything_slept_does_not_count(theatre: FakeBackend) -> None:
    """A closed laptop, or Ctrl-Z and fg."""
    with BaseWorkerPool[str, str](theatre, 1, job_seconds=10) as pool:
        theatre.hear((0, WorkerReady()))
        pool.submit("a")
        listen(pool)
        theatre.script.append((3600.0, []))
        with pytest.raises(TimeoutError):
            pool.next_result(5)
        assert not theatre.puppets[0].killed


def test_a_worker_that_died_at_rest_costs_the_next_job_nothing(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 1) as pool:
        theatre.hear((0, WorkerReady()))
        pool.submit("a")
        theatre.hear((0, JobFinished("A")))
        pool.next_result()
        theatre.puppets[0].deaf = True
        pool.submit("b")
        theatre.hear((0, WorkerDied("x")))
        for k in (1, 2):
            theatre.hear((k, WorkerReady()))
            theatre.hear((k, WorkerDied("x")))
        theatre.hear((3, WorkerReady()))
        theatre.hear((3, JobFinished("B")))
        assert pool.next_result() == ("b", "B")


def test_what_is_heard_together_with_an_error_is_not_lost(theatre: FakeBackend) -> None:
    with BaseWorkerPool[str, str](theatre, 2) as pool:
        theatre.hear((0, WorkerReady()), (1, WorkerReady()))
        pool.submit("a")
        pool.submit("b")
        theatre.hear((0, JobFailed(SimulationError("broken"))), (1, JobFinished("B")))
        with pytest.raises(SimulationError):
            pool.next_result()
        assert pool.next_result() == ("b", "B")
        assert (pool.idle, pool.in_flight) == (2, 0)
