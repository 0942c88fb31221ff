"""What attempts can be made by: processes of this machine, or a Ray cluster."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..config.recording import RecordConfig
from ..resources import Locations
from .collect import EpisodeExecutor
from ..attempt.runner import EpisodeRunner
from .parcel import pack, unpacked_runner
from ..workers.pool import JOB_SECONDS
from ..workers.ray_pool import RayPool
from ..workers.processes import WorkerPool


class Executors(Protocol):
    """Opens what attempts are made by."""

    def open(
        self, config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None], workers: int
    ) -> EpisodeExecutor:
        """Start `workers` workers that draw."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Processes of this machine.

    Attributes:
        job_seconds: how long an attempt may take before its worker is replaced.
    """

    job_seconds: float = JOB_SECONDS

    def open(
        self, config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None], workers: int
    ) -> EpisodeExecutor:
        """Start the processes."""
        factory = functools.partial(EpisodeRunner, config, locations, dict(meshes), draw=True)
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

    def open(
        self, config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None], workers: int
    ) -> EpisodeExecutor:
        """Start the actors."""
        factory = functools.partial(unpacked_runner, config, pack(locations, meshes))
        return RayPool(factory, workers, address=self.address, environ=self.environ, job_seconds=self.job_seconds)
