"""What attempts can be made by: this process, others of this machine, or a Ray cluster."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from ..attempt.runner import EpisodeRunner
from ..session import Session
from ..workers.executor import InlineExecutor
from ..workers.pool import JOB_SECONDS
from ..workers.processes import WorkerPool
from ..workers.ray_pool import RayPool
from .collect import EpisodeExecutor
from .parcel import pack, unpacked_runner


class Executors(Protocol):
    """Opens what attempts are made by."""

    def open(self, session: Session, workers: int) -> EpisodeExecutor:
        """Start `workers` workers that make and render attempts."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Processes of this machine.

    Attributes:
        job_seconds: how long an attempt may take before its worker is replaced.
    """

    job_seconds: float = JOB_SECONDS

    def open(self, session: Session, workers: int) -> EpisodeExecutor:
        """Start the processes."""
        factory = functools.partial(EpisodeRunner, session, render=True)
        return WorkerPool(factory, workers, self.job_seconds)


@dataclass(frozen=True)
class RayCluster:
    """Actors of a Ray cluster, to which robot models and meshes travel as bytes.

    Attributes:
        address, environ: see `RayPool`.
        job_seconds: how long an attempt may take before its worker is replaced.
    """

    address: str | None = None
    environ: Mapping[str, str] = field(default_factory=dict)
    job_seconds: float = JOB_SECONDS

    def open(self, session: Session, workers: int) -> EpisodeExecutor:
        """Start the actors."""
        factory = functools.partial(unpacked_runner, pack(session))
        return RayPool(factory, workers, address=self.address, environ=self.environ, job_seconds=self.job_seconds)


class ThisProcess:
    """This process alone, whatever the number of workers."""

    def open(self, session: Session, workers: int) -> EpisodeExecutor:
        """Make the runner."""
        return InlineExecutor(lambda: EpisodeRunner(session, render=True))
