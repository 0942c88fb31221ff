"""Record a dataset: workers make attempts, this process alone writes."""

from __future__ import annotations

import contextlib
import functools
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..config.record import RecordConfig
from ..dataset.faults import explain
from ..dataset.records import ManifestEntry
from ..dataset.space import EpisodeSize, block_size, check_space
from ..dataset.writer import DatasetWriter, OpenMode
from ..errors import InterruptedJobError, PartialJobError
from ..resources import Locations
from ..types import EpisodeJob, EpisodePayload
from .collect import Collector, EpisodeExecutor, Watch
from .episode import EpisodeRunner, require_one_arm
from .executor import Factory
from .pool import JOB_SECONDS
from .stop import Stop
from .workers import WorkerPool

# Waypoints of the one kind of task there is; only the estimate of disk space depends on it.
_WAYPOINTS = 7


@dataclass(frozen=True)
class RecordReport:
    """What a recording did: episodes and attempts in the dataset now, seconds it took, where an old dataset went."""

    path: Path
    episodes: int
    attempts: int
    seconds: float
    moved_aside: Path | None


@dataclass(frozen=True)
class Output:
    """Where a recording goes, and what to do with what is there."""

    path: Path
    mode: OpenMode


class Executors(Protocol):
    """Opens what attempts are made by."""

    def open(self, factory: Factory[EpisodeJob, EpisodePayload], workers: int) -> EpisodeExecutor:
        """Start `workers` workers."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """`Executors` on this machine; `job_seconds` is how long an attempt may take before its worker is replaced."""

    job_seconds: float = JOB_SECONDS

    def open(self, factory: Factory[EpisodeJob, EpisodePayload], workers: int) -> EpisodeExecutor:
        """Start `workers` processes."""
        return WorkerPool(factory, workers, self.job_seconds)


def record(
    config: RecordConfig,
    locations: Locations,
    meshes: Mapping[str, Path | None],
    output: Output,
    executors: Executors,
    watch: Watch,
    stop: Stop,
) -> RecordReport:
    """Record until the dataset holds `config.episodes` successful episodes; see `collect` for what each one is.

    Raises:
        UsageError, ConfigError, DatasetError, ResourceError: the output cannot be used, see `DatasetWriter`.
        ResourceError: the disk has no room.
        InterruptedJobError: stopped by the user.
        PartialJobError: the disk refused something, workers do not last, or the task fails too often.
    """
    require_one_arm(config)
    began = time.monotonic()
    if output.mode is not OpenMode.RESUME:
        # Before anything is there that would be in the way of the next try.
        _check_space(config, output.path, {}, config.episodes, watch)
    with DatasetWriter(output.path, config.data_config(), output.mode) as writer:
        for repair in writer.repairs:
            watch.warn(repair)
        collector = Collector(config, writer, watch, stop)
        if output.mode is OpenMode.RESUME:
            _check_space(config, writer.path, writer.entries, collector.outstanding, watch)
        with _telling_what_is_left(config, collector, output.path), _manifest_at_the_end(writer):
            if collector.outstanding:
                factory = functools.partial(EpisodeRunner, config, locations, dict(meshes), draw=True)
                with executors.open(factory, min(config.workers, collector.outstanding)) as executor:
                    collector.run(executor)
        moved = writer.moved_aside
    return RecordReport(output.path, writer.episodes, len(writer.attempts), time.monotonic() - began, moved)


@contextlib.contextmanager
def _telling_what_is_left(config: RecordConfig, collector: Collector, place: Path) -> Iterator[None]:
    """Whatever ends a recording early, the user is told what there is and how to go on."""

    def state() -> str:
        return (
            f"{collector.done} of {config.episodes} episodes are whole in {place}, {collector.outstanding} are left; "
            "continue with --resume"
        )

    try:
        yield
    except (KeyboardInterrupt, InterruptedJobError):
        raise InterruptedJobError(f"interrupted: {state()}") from None
    except OSError as error:
        raise PartialJobError(f"{explain(error, place)}: {state()}") from error
    except PartialJobError as error:
        raise PartialJobError(f"{error}: {state()}") from error


@contextlib.contextmanager
def _manifest_at_the_end(writer: DatasetWriter) -> Iterator[None]:
    try:
        yield
    except BaseException:
        # Where the disk refuses even that, the next --resume writes it.
        with contextlib.suppress(OSError):
            writer.finish()
        raise
    writer.finish()


def _check_space(
    config: RecordConfig, place: Path, entries: Mapping[int, ManifestEntry], episodes: int, watch: Watch
) -> None:
    """Refuse what cannot fit, and warn of what may not."""
    timing, cameras = config.task.timing, 2 if config.wrist else 1
    frames = math.ceil((_WAYPOINTS * timing.ticks_per_waypoint + timing.settle_ticks) / timing.ticks_per_frame)
    disk = next(folder for folder in (place, *place.absolute().parents) if folder.is_dir())
    block = block_size(disk)
    size = EpisodeSize.expected(frames, cameras, config.image, block).learned(entries.values(), frames, cameras, block)
    if episodes and (warning := check_space(disk, episodes, size)):
        watch.warn(warning)
