"""Worker pool with actors of a Ray cluster, with the code, retries and time limits of local worker processes.

A job whose actor is lost uses up one try. A new actor then starts where the cluster has capacity.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import signal
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Generic, cast

from ..core.errors import ResourceError
from ..core.workers.executors import J, OpenRunner, R
from ..core.workers.job_server import STOP_SIGNALS, WorkerJobRunner
from ..core.workers.worker_pool import JOB_TIMEOUT, BaseWorkerPool, Worker, WorkerDied, WorkerEvent

_CONNECT_SECONDS = 5.0  # s, to the head of a cluster


class RayPool(BaseWorkerPool[J, R]):
    """An `Executor` that runs jobs in the actors of a Ray cluster, each on one CPU.

    Without address, as for `ray.init`, a cluster starts on this machine and ends with the pool. `environ` is of the
    actor processes. `job_seconds` limits a job, s.
    """

    def __init__(
        self,
        factory: OpenRunner[J, R],
        workers: int,
        *,
        address: str | None = None,
        environ: Mapping[str, str] | None = None,
        job_seconds: float = JOB_TIMEOUT,
    ) -> None:
        super().__init__(_Cluster(factory, workers, address, dict(environ or {})), workers, job_seconds)


class _Actor(Generic[J]):
    def __init__(self, ray: Any, handle: Any, name: str, opened: Any) -> None:
        self._ray = ray
        self._handle = handle
        self.name = name
        # Ray reference to the pending answer; None while the actor is idle.
        self.answer: Any = opened

    def send(self, job: J) -> None:
        self.answer = self._handle.run.remote(job)

    def kill(self) -> None:
        self.answer = None
        self._ray.kill(self._handle, no_restart=True)


class _Cluster(Generic[J, R]):
    """Starts Ray actors as workers, and waits for their answers."""

    def __init__(self, factory: OpenRunner[J, R], workers: int, address: str | None, environ: dict[str, str]) -> None:
        self._ray = _import_ray()
        self._ours = not self._ray.is_initialized()
        if self._ours:
            _connect_ray(self._ray, address, workers)
        cpus = int(self._ray.cluster_resources().get("CPU", 0))
        if cpus < workers:
            self.close()
            raise ResourceError(
                f"the Ray cluster has {cpus} CPUs, and {workers} workers need one each: "
                f"add nodes, or give --workers {cpus}"
            )
        # One copy in the cluster's object store, which each node fetches once.
        self._factory = self._ray.put(pickle.dumps(factory))
        options: dict[str, Any] = {"num_cpus": 1, "max_restarts": 0, "scheduling_strategy": "SPREAD"}
        if environ:
            options["runtime_env"] = {"env_vars": environ}
        self._actors = self._ray.remote(**options)(WorkerJobRunner)

    def start(self, number: int) -> Worker[J]:
        handle = self._actors.remote()
        return _Actor[J](self._ray, handle, f"ray-worker-{number}", handle.create_runner.remote(self._factory))

    def wait(self, workers: Sequence[Worker[J]], timeout: float) -> list[tuple[Worker[J], WorkerEvent[R]]]:
        actors = [worker for worker in workers if isinstance(worker, _Actor)]
        awaited = {actor.answer: actor for actor in actors if actor.answer is not None}
        if not awaited:
            time.sleep(timeout)
            return []
        ready, _ = self._ray.wait(list(awaited), num_returns=1, timeout=timeout)
        return [(awaited[answer], self._receive_event(awaited[answer])) for answer in ready]

    def _receive_event(self, actor: _Actor[J]) -> WorkerEvent[R]:
        answer, actor.answer = actor.answer, None
        try:
            return cast("WorkerEvent[R]", pickle.loads(self._ray.get(answer)))
        except self._ray.exceptions.RayError as error:
            return WorkerDied(f"was lost by Ray: {str(error).splitlines()[0]}")

    def close(self) -> None:
        if self._ours:
            self._ray.shutdown()


def _import_ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ResourceError("--executor ray needs the package ray: pip install 'yamsim[ray]'") from error
    return ray


def _connect_ray(ray: Any, address: str | None, workers: int) -> None:
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
    with _restore_signal_handlers():
        try:
            if address is None:
                ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
            else:
                _require_listener(address)
                ray.init(address=address, **quiet)
        # Includes SystemExit: if the head is gone, Ray waits for it and then sends SIGTERM to its own process.
        except (OSError, RuntimeError, ValueError, SystemExit, ray.exceptions.RayError) as error:
            reason = "no answer" if isinstance(error, SystemExit) else f"{error}".partition("\n")[0]
            where = f"at {address}" if address else "on this machine"
            raise ResourceError(f"no Ray cluster {where}: {reason}; start one with `ray start --head`") from error


def _require_listener(address: str) -> None:
    """Raise OSError if no server listens at a HOST:PORT, which Ray itself reports after minutes."""
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if colon and port.isdecimal():
        socket.create_connection((host, int(port)), _CONNECT_SECONDS).close()


@contextlib.contextmanager
def _restore_signal_handlers() -> Iterator[None]:
    """Restore signal handlers after the block, because Ray replaces the handler of SIGTERM."""
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            # Only the main thread can set handlers. In other threads, Ray cannot replace them either.
            with contextlib.suppress(ValueError):
                signal.signal(number, handler)
