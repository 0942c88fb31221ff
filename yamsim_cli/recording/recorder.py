"""Records a dataset: workers make attempts, and this process alone writes."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.dataset.disk_faults import explain
from ..core.errors import InterruptedJobError, PartialJobError, ResourceError
from ..core.scene.assets import load_lock
from ..core.scene.build import noting_meshes
from ..core.scene.certificates import Standing, find_certificate
from ..core.workers.stop import Stop
from .collect import Collector, Notifier
from .destination import Destination, Output, open_destination
from .executors import Executors
from .prospects import GaveUpError, no_better_start


@dataclass(frozen=True)
class RecordReport:
    """Episodes and attempts in the dataset, the recording's duration, and the new place of an earlier dataset."""

    path: Path
    episodes: int
    attempts: int
    seconds: float
    moved_aside: Path | None


def record(session: Session, output: Output, executors: Executors, watch: Notifier, stop: Stop) -> RecordReport:
    """Record until the dataset holds the config's `episodes` successful episodes, see `collect`.

    Raises:
        UsageError, ConfigError, DatasetError, ResourceError: see `open_destination`; or a thing has failed its
            certificate.
        InterruptedJobError: stopped by the user.
        PartialJobError: the disk refused something, workers do not last, or the task fails too often.
        SimulationError: the task cannot work as it is.
    """
    began = time.monotonic()
    _check_certificates(session, watch)
    session = noting_meshes(session)
    config = session.config
    with open_destination(config, output, watch) as destination:
        starts = functools.partial(no_better_start, session)
        collector = Collector(destination.config, destination.sink, watch, stop, starts)
        with _reporting_what_is_left(config, collector, destination):
            if collector.work:
                # A resumed recording may have given up before.
                collector.check_prospects()
                workers = min(config.workers, collector.work)
                with executors.open(session, workers) as executor:
                    collector.run(executor)
            destination.finish(watch, stop)
        sink, moved = destination.sink, destination.writer.moved_aside
    return RecordReport(output.path, sink.episodes, len(sink.attempts), time.monotonic() - began, moved)


def _check_certificates(session: Session, watch: Notifier) -> None:
    """Refuse a thing that has failed its certificate, and warn of one that has changed since."""
    config, locations = session.config, session.locations
    lock = load_lock(locations)
    for item in (*config.task.objects, *config.randomization.extras):
        found = find_certificate(locations.assets, item, lock)
        if found.standing is Standing.FAILED:
            raise ResourceError(
                f"{item.name} has failed its certificate: {', '.join(found.failed)}; mend it and run `yamsim assets "
                f"certify` again, or delete {found.path} to record it as it is"
            )
        if found.standing is Standing.STALE:
            watch.warn(f"The certificate of {item.name} is of what it was before: run `yamsim assets certify` again.")


@contextlib.contextmanager
def _reporting_what_is_left(config: RecordConfig, collector: Collector, destination: Destination) -> Iterator[None]:
    """If the recording ends early, write the manifest, and state in the error what is recorded and what is left."""
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
