"""Record a dataset: workers make attempts, this process alone writes."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..config.record import RecordConfig
from ..dataset.faults import explain
from ..errors import InterruptedJobError, PartialJobError
from ..resources import Locations
from ..scene.build import noting_meshes
from .collect import Collector, Watch
from .destination import Destination, Output, open_destination
from .executors import Executors
from .prospects import GaveUpError, hopeless
from .stop import Stop


@dataclass(frozen=True)
class RecordReport:
    """What a recording did: episodes and attempts in the dataset now, seconds it took, where an old dataset went."""

    path: Path
    episodes: int
    attempts: int
    seconds: float
    moved_aside: Path | None


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
        UsageError, ConfigError, DatasetError, ResourceError: the output cannot be used, see `open_destination`.
        InterruptedJobError: stopped by the user.
        PartialJobError: the disk refused something, workers do not last, or the task fails too often.
        SimulationError: the task cannot work as it is.
    """
    began = time.monotonic()
    config = noting_meshes(config, locations, meshes)
    with open_destination(config, output, watch) as destination:
        prospects = functools.partial(hopeless, config, locations)
        collector = Collector(destination.config, destination.sink, watch, stop, prospects)
        with _telling_what_is_left(config, collector, destination):
            if collector.work:
                # A resumed recording may be one that gave up.
                collector.check_prospects()
                workers = min(config.workers, collector.work)
                with executors.open(config, locations, meshes, workers) as executor:
                    collector.run(executor)
            destination.finish(watch, stop)
        sink, moved = destination.sink, destination.writer.moved_aside
    return RecordReport(output.path, sink.episodes, len(sink.attempts), time.monotonic() - began, moved)


@contextlib.contextmanager
def _telling_what_is_left(config: RecordConfig, collector: Collector, destination: Destination) -> Iterator[None]:
    """Whatever ends a recording early, the manifest is written, and the user told what there is and how to go on."""
    place = destination.writer.path

    def whole() -> str:
        return f"{collector.done} of {config.episodes} episodes are whole in {place}{destination.rest}"

    def state() -> str:
        return f"{whole()}, {collector.outstanding} are left; continue with --resume"

    try:
        try:
            yield
        except BaseException:
            destination.give_up()
            raise
    except (KeyboardInterrupt, InterruptedJobError):
        raise InterruptedJobError(f"interrupted: {state()}") from None
    except OSError as error:
        raise PartialJobError(f"{explain(error, place)}: {state()}") from error
    except GaveUpError as error:
        raise GaveUpError(f"{error}; {whole()}") from error
    except PartialJobError as error:
        raise PartialJobError(f"{error}: {state()}") from error
