from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..camera_rendering import require_fixed_plates
from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.dataset.disk_errors import explain_disk_error
from ..core.dataset.writing.staged_writer import EpisodeWriter
from ..core.errors import InterruptedJobError, PartialJobError, ResourceError, UsageError
from ..core.scene.assets import load_lock
from ..core.scene.build import with_mesh_descriptions
from ..core.scene.certificates import CertificateStatus, find_certificate
from ..core.workers.stop_request import StopRequest
from .collect import Collector, RecordCallbacks
from .executor_factories import ExecutorFactory
from .recording_output import OpenRecordingOutput, RecordingOutput, open_destination
from .retry_limit import RetryLimitError, all_starts_fail


@dataclass(frozen=True)
class RecordReport:
    """Result of a recording: totals of the dataset, duration, s, and backup path of an earlier dataset."""

    path: Path
    episodes: int
    attempts: int
    seconds: float
    moved_aside: Path | None


def record(
    session: Session,
    output: RecordingOutput,
    executor_factory: ExecutorFactory,
    callbacks: RecordCallbacks,
    stop: StopRequest,
) -> RecordReport:
    """Record until the dataset holds as many successful episodes as the config requests.

    Raises UsageError for looks that are held out for tests of policies.
    """
    began = time.monotonic()
    session = require_recordable(session, callbacks)
    starts = functools.partial(all_starts_fail, session)

    def make_collector(config: RecordConfig, sink: EpisodeWriter) -> Collector:
        return Collector(config, sink, callbacks, stop, starts)

    return fill_dataset(session, output, executor_factory, make_collector, callbacks, stop, began)


def require_recordable(session: Session, callbacks: RecordCallbacks) -> Session:
    """Return the session with its meshes stated. Raise UsageError and ResourceError for looks and objects to refuse."""
    if session.config.randomization.held_out:
        raise UsageError(
            f"randomization {session.config.randomization.name!r} is held out for tests of policies, so nothing is "
            "recorded with it; give another, such as looks, or test a policy with `yamsim eval --randomization`"
        )
    _check_certificates(session, callbacks)
    return with_mesh_descriptions(session)


def fill_dataset(
    session: Session,
    output: RecordingOutput,
    executor_factory: ExecutorFactory,
    make_collector: Callable[[RecordConfig, EpisodeWriter], Collector],
    callbacks: RecordCallbacks,
    stop: StopRequest,
    began: float,
) -> RecordReport:
    """Open the output, and run a collector with the factory's workers until the dataset is complete.

    `session` states its meshes. `began` is the start of the job on the monotonic clock, s.
    """
    config = session.config
    require_fixed_plates(config)
    with open_destination(config, output, callbacks) as destination:
        collector = make_collector(destination.config, destination.episode_writer)
        with _report_on_early_end(collector, destination):
            if collector.attempts_needed:
                # A resumed recording may have reached the retry limit in its earlier run.
                collector.check_retry_limit()
                workers = min(config.workers, collector.attempts_needed)
                with executor_factory(session, workers) as executor:
                    collector.run(executor)
            collector.finish()
            destination.finish(callbacks, stop)
        sink, moved = destination.episode_writer, destination.writer.moved_aside
    return RecordReport(output.path, sink.episodes, len(sink.attempts), time.monotonic() - began, moved)


def _check_certificates(session: Session, callbacks: RecordCallbacks) -> None:
    """Refuse an object that failed its certification. Warn about an object that changed since."""
    config, locations = session.config, session.locations
    lock = load_lock(locations)
    for item in (*config.task.objects, *config.randomization.distractor_configs):
        found = find_certificate(locations.assets, item, lock)
        if found.status is CertificateStatus.FAILED:
            raise ResourceError(
                f"{item.name} has failed its certificate: {', '.join(found.failed)}; correct it and run `yamsim assets "
                f"certify` again, or delete {found.path} to record it as it is"
            )
        if found.status is CertificateStatus.STALE:
            callbacks.warn(f"The certificate of {item.name} is out of date: run `yamsim assets certify` again.")


@contextlib.contextmanager
def _report_on_early_end(collector: Collector, destination: OpenRecordingOutput) -> Iterator[None]:
    """At an early end, write the manifest, and add recorded and remaining episodes to the error."""
    place = destination.writer.path

    def complete_episodes_text() -> str:
        return f"{collector.describe_progress()} in {place}{destination.describe_staged}"

    def progress_text() -> str:
        return f"{complete_episodes_text()}, {collector.remaining} are left; continue with --resume"

    try:
        try:
            yield
        except BaseException:
            destination.close_after_error()
            raise
    except (KeyboardInterrupt, InterruptedJobError):
        raise InterruptedJobError(f"interrupted: {progress_text()}") from None
    except OSError as error:
        raise PartialJobError(f"{explain_disk_error(error, place)}: {progress_text()}") from error
    except RetryLimitError as error:
        raise RetryLimitError(f"{error}; {complete_episodes_text()}") from error
    except PartialJobError as error:
        raise PartialJobError(f"{error}: {progress_text()}") from error
