"""Record a dataset: workers make attempts, this process alone writes."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..config.record import RecordConfig
from ..dataset.records import AttemptRecord, EpisodeRecord, OutcomeRecord, attempt_record, file_hashes
from ..dataset.writer import DatasetWriter, OpenMode
from ..errors import DatasetError, InterruptedJobError, PartialJobError
from ..resources import Locations
from ..types import EpisodeJob, EpisodePayload
from .episode import EpisodeRunner, require_one_arm
from .workers import WorkerPool

# A task that fails this often will not be finished by trying on.
_MAX_ATTEMPTS_PER_EPISODE = 20

# How far attempts may run ahead of the oldest unfinished one, per worker: bounds the episodes held in memory.
_LOOKAHEAD = 4


@dataclass(frozen=True)
class RecordReport:
    """What a recording did: episodes and attempts in the dataset now, seconds it took, where an old dataset went."""

    path: Path
    episodes: int
    attempts: int
    seconds: float
    moved_aside: Path | None


# Called with episodes done, episodes wanted and attempts made.
Progress = Callable[[int, int, int], None]


def record(
    config: RecordConfig,
    locations: Locations,
    meshes: Mapping[str, Path | None],
    out: Path,
    mode: OpenMode,
    progress: Progress,
) -> RecordReport:
    """Record until the dataset holds `config.episodes` successful episodes.

    Episode k is the k-th attempt that succeeds, in order of attempt and whichever worker finished first: so the data
    depends on the configuration and the seed alone.

    Raises:
        UsageError, ConfigError, DatasetError, ResourceError: the output cannot be used, see `DatasetWriter`.
        InterruptedJobError: stopped by the user.
        PartialJobError: the disk is full, a worker died, or the task fails too often.
    """
    require_one_arm(config)
    began = time.monotonic()
    writer = DatasetWriter(out, config.data_config(), mode)
    session = _Session(config, writer, progress)
    try:
        if not session.complete:
            factory = functools.partial(EpisodeRunner, config, locations, dict(meshes), draw=True)
            wanted = min(config.workers, session.outstanding)
            with WorkerPool(factory, wanted) as pool:
                session.run(pool)
    except KeyboardInterrupt:
        raise InterruptedJobError(f"interrupted: {session.state()}; continue with --resume") from None
    except OSError as error:
        what = f"{error.filename or out}: {error.strerror or error}"
        raise PartialJobError(f"{what}: {session.state()}; mend it and continue with --resume") from error
    except PartialJobError as error:
        raise PartialJobError(f"{error}: {session.state()}; continue with --resume") from error
    finally:
        session.finish()
    return RecordReport(out, writer.episodes, len(writer.attempts), time.monotonic() - began, writer.moved_aside)


class _Session:
    """Puts finished attempts into order, and orders into the dataset."""

    def __init__(self, config: RecordConfig, writer: DatasetWriter, progress: Progress) -> None:
        self._config = config
        self._writer = writer
        self._progress = progress
        # Attempts whose episode was lost are made again first, under their old numbers.
        self._lost = {attempt.attempt: attempt for attempt in writer.missing}
        self._queue = sorted(self._lost, reverse=True)
        self._next = len(writer.attempts)
        self._finished: dict[int, EpisodePayload] = {}

    @property
    def outstanding(self) -> int:
        """Episodes that still have to be made."""
        return max(0, self._config.episodes - self._writer.episodes) + len(self._lost)

    @property
    def complete(self) -> bool:
        return self.outstanding == 0

    def state(self) -> str:
        """For messages: what the dataset holds."""
        done = self._writer.episodes - len(self._lost)
        return f"{done} of {self._config.episodes} episodes are whole in {self._writer.path}"

    def run(self, pool: WorkerPool[EpisodeJob, EpisodePayload]) -> None:
        self._report()
        while not self.complete:
            while pool.idle and self._may_start(pool):
                pool.submit(EpisodeJob(self._config.seed, self._take()))
            job, payload = pool.result()
            if job.attempt in self._lost:
                self._restore(payload)
            else:
                self._finished[job.attempt] = payload
            while (done := self._finished.pop(len(self._writer.attempts), None)) is not None:
                self._commit(done)
            self._report()

    def finish(self) -> None:
        """Write the manifest; when the disk refuses even that, it is rebuilt by the next `--resume`."""
        try:
            self._writer.finish()
        except OSError:
            return

    def _may_start(self, pool: WorkerPool[EpisodeJob, EpisodePayload]) -> bool:
        """Never more attempts than could still be needed, were they all to succeed."""
        if self._queue:
            return True
        promised = pool.in_flight + sum(payload.outcome.success for payload in self._finished.values())
        ahead = self._next - len(self._writer.attempts)
        return promised < self.outstanding and ahead < _LOOKAHEAD * self._config.workers

    def _take(self) -> int:
        if self._queue:
            return self._queue.pop()
        if self._next >= _MAX_ATTEMPTS_PER_EPISODE * self._config.episodes:
            last = self._writer.attempts[-1].outcome
            raise PartialJobError(
                f"gave up after {self._next} attempts, the last one failed as {last.cause}: {last.detail}"
            )
        self._next += 1
        return self._next - 1

    def _commit(self, payload: EpisodePayload) -> None:
        episode = self._writer.episodes if payload.outcome.success else None
        if episode is not None:
            self._publish(payload, episode)
        self._writer.log(attempt_record(payload, episode))

    def _restore(self, payload: EpisodePayload) -> None:
        """Publish a lost episode again, under its old number."""
        lost = self._lost[payload.job.attempt]
        if not payload.outcome.success or lost.episode is None:
            raise DatasetError(
                f"{self._writer.path}: attempt {lost.attempt} gave episode {lost.episode} once and fails now "
                f"({payload.outcome.cause}): this machine or its packages differ from those that recorded it"
            )
        self._publish(payload, lost.episode)
        del self._lost[lost.attempt]

    def _publish(self, payload: EpisodePayload, episode: int) -> None:
        config = self._config
        attempt: AttemptRecord = attempt_record(payload, episode)
        cameras = dict.fromkeys(
            (name.split("/")[1] for name in payload.files if name.startswith("rgb/")), config.image.size_px
        )
        record = EpisodeRecord(
            episode=episode,
            attempt=attempt.attempt,
            seed=attempt.seed,
            source="record",
            rig=config.rig.name,
            scene=config.scene.name,
            task=config.task.name,
            grasp=config.grasp,
            frames=payload.frames,
            frame_period_s=config.task.timing.tick * config.task.timing.ticks_per_frame,
            cameras=cameras,
            objects=[config.task.object.name, config.task.target.name],
            outcome=OutcomeRecord.of(payload.outcome),
            max_height_m=config.task.success.max_height,
            layout=attempt.layout,
            versions=dict(payload.versions),
            renderer=payload.renderer,
            content_sha256=payload.content_sha256,
            files=file_hashes(payload.files),
        )
        self._writer.publish(record, dict(payload.files))

    def _report(self) -> None:
        self._progress(self._writer.episodes - len(self._lost), self._config.episodes, len(self._writer.attempts))
