from __future__ import annotations

import multiprocessing
import os
from multiprocessing.process import BaseProcess

import pytest

from tests.core.workers.toy_runners import ToyRunner
from yamsim_cli.core.workers.process_pool import ProcessPool
from yamsim_cli.early_worker import EarlyWorker


def _early_worker() -> tuple[EarlyWorker, BaseProcess]:
    others = multiprocessing.active_children()
    early = EarlyWorker()
    (process,) = (child for child in multiprocessing.active_children() if child not in others)
    return early, process


def test_the_first_worker_of_a_pool_is_the_early_one(monkeypatch: pytest.MonkeyPatch) -> None:
    early, process = _early_worker()
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    with early, ProcessPool[int | str, object](ToyRunner, 1, start=early.start) as pool:
        early.close()  # leaves a process that a pool has taken
        pool.submit("pid")
        assert pool.next_result()[1] == process.pid
        pool.submit("variable:MUJOCO_GL")
        assert pool.next_result()[1] == "disabled"
    assert process.exitcode is not None


def test_an_early_worker_that_has_ended_is_replaced() -> None:
    early, process = _early_worker()
    process.kill()
    process.join()
    with early, ProcessPool[int | str, object](ToyRunner, 1, start=early.start) as pool:
        pool.submit("pid")
        assert pool.next_result()[1] not in (process.pid, os.getpid())


def test_an_early_worker_that_no_pool_takes_is_ended() -> None:
    early, process = _early_worker()
    with early:
        assert process.is_alive()
    assert not process.is_alive()
    early.close()
