from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from ..core.workers.executors import Executor, InlineExecutor, OpenRunner, run_all
from ..core.workers.process_pool import ProcessPool

J = TypeVar("J")
R = TypeVar("R")


def run_episode_jobs(factory: OpenRunner[J, R], jobs: Iterable[J], workers: int) -> Iterator[tuple[J, R]]:
    """Yield each job of an episode with its result, in the order in which jobs finish. 0 `workers`: in this process."""
    executor: Executor[J, R] = ProcessPool[J, R](factory, workers) if workers else InlineExecutor(factory)
    with executor as pool:
        yield from run_all(pool, jobs)


def parallel(workers: int, episodes: Sized) -> int:
    """Return the number of processes for some episodes; 0 if one is enough, for `run_episode_jobs`."""
    processes = min(workers, len(episodes))
    return processes if processes > 1 else 0
