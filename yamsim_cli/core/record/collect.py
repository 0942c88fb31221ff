"""Put finished attempts into order, and in order into the dataset.

Episode k is the k-th attempt that succeeds, in order of attempt and whichever worker finished first: so the data
depends on the configuration and the seed alone.

An attempt that ends every worker it is given to becomes a failure of its own cause, `worker_lost`, and stays one when
the recording is resumed: the episodes after it are numbered without it. Since such an end can also be the machine's
fault, it is only believed once another attempt has come back well since. If none does, the recording stops, and
nothing of it is in the dataset: `--resume` tries those attempts again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from ..config.recording import RecordConfig
from ..dataset.layout import episode_name
from ..dataset.records import AttemptRecord, EpisodeRecord, attempt_record
from ..dataset.writing.ledger import vacant_episode
from ..errors import DatasetError, InterruptedJobError, PartialJobError
from ..types import Attempt, Cause, EpisodeJob, EpisodePayload, Outcome
from ..workers.executor import Executor, LostJobError
from ..workers.stop import Stop
from .episode_record import episode_record
from .prospects import Hopeless, Patience

# How far attempts may run ahead of the oldest unfinished one, per worker: bounds the episodes held in memory.
_LOOKAHEAD = 4
# When this many attempts in a row lose their workers, it is the machine.
_MAX_LOST_IN_A_ROW = 3
# How long the episodes in hand may take once the user wants to stop.
_STOP_SECONDS = 60.0
_POLL_SECONDS = 0.5

EpisodeExecutor = Executor[EpisodeJob, EpisodePayload]


class Sink(Protocol):
    """Where a recording goes; `DatasetWriter` is one."""

    path: Path
    attempts: list[AttemptRecord]
    episodes: int

    # Attempts whose line in the ledger is lost: they are made and logged again.
    untold: set[int]

    @property
    def missing(self) -> list[AttemptRecord]:
        """Attempts whose episode has to be made again."""
        ...

    def publish(self, record: EpisodeRecord, files: dict[str, bytes]) -> None:
        """Make an episode visible."""
        ...

    def log(self, attempt: AttemptRecord) -> None:
        """Add an attempt to the ledger, after its episode."""
        ...


@dataclass(frozen=True)
class Notifier:
    """Who is told how a recording goes.

    Attributes:
        progress: called with episodes done, episodes wanted and attempts made.
        warn: called with a sentence that the user should read.
    """

    progress: Callable[[int, int, int], None]
    warn: Callable[[str], None]


class Collector:
    """Hands out attempts and takes their results until the dataset is complete.

    Args:
        hopeless: see `prospects.hopeless`.
    """

    def __init__(self, config: RecordConfig, sink: Sink, watch: Notifier, stop: Stop, hopeless: Hopeless) -> None:
        self._config = config
        self._patience = Patience(config, hopeless)
        self._sink = sink
        self._watch = watch
        self._stop = stop
        # Attempts whose episode or line is gone are made again first, under their old numbers.
        self._gone = {attempt.attempt: attempt for attempt in sink.missing}
        self._queue = sorted(self._gone.keys() | sink.untold, reverse=True)
        self._next = len(sink.attempts)
        self._finished: dict[int, EpisodePayload] = {}
        self._doubtful: set[int] = set()
        self._renderer = ""

    @property
    def outstanding(self) -> int:
        """Episodes that still have to be made."""
        return max(0, self._config.episodes - self._sink.episodes) + len(self._gone)

    @property
    def work(self) -> int:
        """Attempts that have to be made at least."""
        return self.outstanding + len(self._sink.untold)

    @property
    def done(self) -> int:
        """Episodes that are whole."""
        return self._sink.episodes - len(self._gone)

    def run(self, executor: EpisodeExecutor) -> None:
        """Record until the dataset holds all episodes.

        Raises:
            InterruptedJobError: the user wants to stop; attempts in hand were waited for, within bounds.
            DatasetError: an episode that was lost cannot be made again here.
            PartialJobError: the task fails too often, or workers do not last.
            SimulationError: the task cannot work, see `check_prospects`.
            OSError: the disk refused something.
        """
        self._report()
        while self.work:
            while not self._stop.asked and executor.idle and self._may_start(executor):
                executor.submit(EpisodeJob(self._config.seed, self._take()))
            # Only now, so that the workers are busy while the disk is.
            if self._commit_finished():
                continue
            if self._stop.asked and (not executor.in_flight or self._stop.waited > _STOP_SECONDS):
                raise InterruptedJobError("interrupted")
            self._receive(executor)

    def _receive(self, executor: EpisodeExecutor) -> None:
        try:
            job, payload = executor.result(_POLL_SECONDS)
        except TimeoutError:
            return
        except LostJobError as error:
            self._lose(error)
            return
        self._doubtful.clear()
        self._compare_renderers(payload)
        self._finished[job.attempt] = payload

    def _commit_finished(self) -> bool:
        """Write what can be written, in the order of attempts; whether there was anything."""
        before = len(self._finished)
        for attempt in self._gone.keys() & self._finished.keys():
            self._restore(self._finished.pop(attempt))
        while (untold := min(self._sink.untold, default=-1)) in self._finished:
            self._tell_again(self._finished.pop(untold))
        # Episodes are counted on only when it is known what came before.
        while not self._sink.untold and self._next_is_finished:
            self._commit(self._finished.pop(len(self._sink.attempts)))
        if len(self._finished) == before:
            return False
        self._report()
        return True

    @property
    def _next_is_finished(self) -> bool:
        attempt = len(self._sink.attempts)
        return attempt in self._finished and attempt not in self._doubtful

    def _may_start(self, executor: EpisodeExecutor) -> bool:
        """Never more attempts than could still be needed, were they all to succeed."""
        if self._queue:
            return True
        if self._next >= self._patience.most_attempts and not self._doubtful:
            return False
        promised = executor.in_flight + sum(payload.outcome.success for payload in self._finished.values())
        ahead = self._next - len(self._sink.attempts)
        # A doubtful attempt holds the rest back until another one has come back.
        near = ahead < _LOOKAHEAD * self._config.workers or (self._doubtful and not executor.in_flight)
        return promised < self.outstanding and bool(near)

    def _take(self) -> int:
        if self._queue:
            return self._queue.pop()
        self._next += 1
        return self._next - 1

    def _lose(self, error: LostJobError) -> None:
        job = error.job
        assert isinstance(job, EpisodeJob)
        if job.attempt in self._gone:
            number = self._gone[job.attempt].episode
            raise PartialJobError(f"{episode_name(number or 0)} cannot be made again: {error}") from error
        if job.attempt in self._sink.untold:
            self._lose_again(job, error)
            return
        self._doubtful.add(job.attempt)
        if len(self._doubtful) >= _MAX_LOST_IN_A_ROW:
            raise PartialJobError(f"{len(self._doubtful)} attempts in a row lost their workers, the last one: {error}")
        detail = f"ended its worker {error.tries} times; the last one {error.reason}"
        self._finished[job.attempt] = EpisodePayload(Attempt(job), Outcome(False, Cause.WORKER_LOST, detail))
        self._watch.warn(f"Attempt {job.attempt} {detail}. It will count as a failure unless others fail like it.")

    def _commit(self, payload: EpisodePayload) -> None:
        episode = self._sink.episodes if payload.outcome.success else None
        if episode is not None:
            self._publish(payload, episode)
        self._sink.log(attempt_record(payload, episode))
        self.check_prospects()

    def check_prospects(self) -> None:
        """Go on only if the attempts so far leave hope for the episodes that are wanted still.

        Raises:
            GaveUpError: the task works too rarely.
            SimulationError: it cannot work.
        """
        if self._sink.untold:
            # What those attempts came to may be what hope there is.
            return
        if self.outstanding > len(self._gone) and (
            error := self._patience.ended_by(self._sink.attempts, self._sink.episodes)
        ):
            raise error

    def _restore(self, payload: EpisodePayload) -> None:
        """Publish a lost episode again, under its old number."""
        lost = self._gone[payload.job.attempt]
        if not payload.outcome.success or lost.episode is None:
            raise self._otherwise(payload, lost.episode or 0)
        self._publish(payload, lost.episode)
        del self._gone[lost.attempt]

    def _otherwise(self, payload: EpisodePayload, episode: int) -> DatasetError:
        return DatasetError(
            f"{self._sink.path}: attempt {payload.job.attempt} gave {episode_name(episode)} once and fails now "
            f"({payload.outcome.cause}): this machine or its packages differ from those that recorded it"
        )

    def _tell_again(self, payload: EpisodePayload) -> None:
        """Log an attempt whose line was lost. One that succeeds now, and gave no episode then, had lost its workers."""
        number = vacant_episode(self._sink.attempts, payload.job.attempt)
        if payload.outcome.success and number is None:
            detail = (
                "its line in the ledger was lost; made again it succeeds, and the episodes after it do not count it"
            )
            payload = replace(payload, outcome=Outcome(False, Cause.WORKER_LOST, detail), files={})
        episode = number if payload.outcome.success else None
        if episode is not None:
            self._publish(payload, episode)
        elif number is not None and number < self._sink.episodes and len(self._sink.untold) == 1:
            # There are later ones, and no other attempt that it could have come from.
            raise self._otherwise(payload, number)
        self._sink.log(attempt_record(payload, episode))
        self.check_prospects()

    def _lose_again(self, job: EpisodeJob, error: LostJobError) -> None:
        if vacant_episode(self._sink.attempts, job.attempt) is not None:
            raise PartialJobError(f"attempt {job.attempt} cannot be made again: {error}") from error
        detail = f"ended its worker {error.tries} times; the last one {error.reason}"
        self._finished[job.attempt] = EpisodePayload(Attempt(job), Outcome(False, Cause.WORKER_LOST, detail))

    def _publish(self, payload: EpisodePayload, episode: int) -> None:
        self._sink.publish(episode_record(self._config, payload, episode), dict(payload.files))

    def _compare_renderers(self, payload: EpisodePayload) -> None:
        """Different drivers render other bytes: the user should know that the dataset depends on who rendered what."""
        if self._renderer and payload.renderer and payload.renderer != self._renderer:
            self._watch.warn(
                f"Workers render with different OpenGL ({self._renderer}; {payload.renderer}): "
                "which of them rendered an episode decides its images' bytes."
            )
        self._renderer = payload.renderer or self._renderer

    def _report(self) -> None:
        self._watch.progress(self.done, self._config.episodes, len(self._sink.attempts))
