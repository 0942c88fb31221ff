"""Distribute attempts to workers, and write finished attempts to the dataset in order.

Episode k is the k-th successful attempt in the order of attempts, whichever worker finishes first. The data therefore
depends only on the configuration and the seed.

An attempt that crashes all its workers becomes a failure with cause `worker_lost`, also after a resume, because later
episodes are numbered without it. The crash can also be the machine's fault, so the attempt is uncertain until another
one finishes. If none does, the recording stops without writing uncertain attempts, and `--resume` tries them again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..core.attempt_data import Attempt, AttemptJob, AttemptPayload, FailureCause, Outcome
from ..core.config.recording import RecordConfig
from ..core.dataset.dataset_paths import episode_name
from ..core.dataset.records import AttemptRecord, EpisodeRecord, attempt_record, episode_record
from ..core.dataset.writing.ledger import missing_episode
from ..core.dataset.writing.staged_writer import EpisodeWriter
from ..core.errors import DatasetError, InterruptedJobError, PartialJobError
from ..core.workers.executors import Executor, LostJobError
from ..core.workers.stop_request import StopRequest
from .retry_limit import AllStartsFailFunction, RetryLimit

_MAX_ATTEMPTS_AHEAD = 4  # attempts per worker beyond the oldest unwritten one; limits the episodes in memory
_MAX_LOST_IN_A_ROW = 3  # lost attempts, after which the machine is considered at fault
_STOP_SECONDS = 60.0  # s, for running attempts after a stop request
_POLL_SECONDS = 0.5  # s between checks of the stop request

EpisodeExecutor = Executor[AttemptJob, AttemptPayload]


@dataclass(frozen=True)
class RecordCallbacks:
    """Callbacks of a recording.

    Attributes:
        progress: called with the numbers of finished episodes, requested episodes and attempts.
    """

    progress: Callable[[int, int, int], None]
    warn: Callable[[str], None]


class Collector:
    """Submits attempts to an executor, and writes their results, until the dataset is complete."""

    def __init__(
        self,
        config: RecordConfig,
        sink: EpisodeWriter,
        callbacks: RecordCallbacks,
        stop: StopRequest,
        no_better_start: AllStartsFailFunction,
    ) -> None:
        self._config = config
        self._limit = RetryLimit(config, no_better_start)
        self._sink = sink
        self._watch = callbacks
        self._stop = stop
        # Attempts whose episode or ledger line is lost are repeated first, under their old numbers.
        self._lost_attempts = {attempt.attempt: attempt for attempt in sink.attempts_without_episode}
        self._queue = sorted(self._lost_attempts.keys() | sink.lost_lines, reverse=True)
        self._next = len(sink.attempts)
        self._finished: dict[int, AttemptPayload] = {}
        self._uncertain_attempts: set[int] = set()
        self._renderer = ""

    @property
    def remaining(self) -> int:
        """Number of episodes still to be recorded, including lost episodes of a resumed dataset."""
        return max(0, self._config.episodes - self._sink.episodes) + len(self._lost_attempts)

    @property
    def attempts_needed(self) -> int:
        """Smallest number of attempts that are still needed."""
        return self.remaining + len(self._sink.lost_lines)

    @property
    def complete_episodes(self) -> int:
        """Number of episodes that are completely in the dataset."""
        return self._sink.episodes - len(self._lost_attempts)

    def describe_progress(self) -> str:
        """Return how much is complete, as a clause for messages."""
        return f"{self.complete_episodes} of {self._config.episodes} episodes are complete"

    def run(self, executor: EpisodeExecutor) -> None:
        """Record until the dataset is complete. After a stop, running attempts have `_STOP_SECONDS` to finish."""
        self._report_progress()
        while self.attempts_needed:
            while not self._stop.is_requested and executor.idle and self._may_start_attempt(executor):
                executor.submit(AttemptJob(self._config.seed, self._next_attempt()))
            # Write after submitting: workers are busy meanwhile.
            if self._commit_finished():
                continue
            if self._stop.is_requested and (not executor.in_flight or self._stop.seconds_since_request > _STOP_SECONDS):
                raise InterruptedJobError("interrupted")
            self._receive(executor)

    def finish(self) -> None:
        """Do what is left when all episodes are written: nothing in a recording."""

    def _receive(self, executor: EpisodeExecutor) -> None:
        try:
            job, payload = executor.next_result(_POLL_SECONDS)
        except TimeoutError:
            return
        except LostJobError as error:
            self._mark_lost(error)
            return
        self._uncertain_attempts.clear()
        self._compare_renderers(payload)
        self._finished[job.attempt] = payload

    def _commit_finished(self) -> bool:
        """Write all results that are next in the order of attempts; return whether there were any."""
        before = len(self._finished)
        for attempt in self._lost_attempts.keys() & self._finished.keys():
            with self._stop.uninterrupted():
                self._restore_lost_episode(self._finished.pop(attempt))
        while (lost := min(self._sink.lost_lines, default=-1)) in self._finished:
            with self._stop.uninterrupted():
                self._log_restored_attempt(self._finished.pop(lost))
        # New episodes get numbers only when the outcomes of all earlier attempts are known.
        while not self._sink.lost_lines and self._next_is_finished:
            # An episode, its line in the ledger and its entry in the manifest belong together.
            with self._stop.uninterrupted():
                self._commit_attempt(self._finished.pop(len(self._sink.attempts)))
        if len(self._finished) == before:
            return False
        self._report_progress()
        return True

    @property
    def _next_is_finished(self) -> bool:
        attempt = len(self._sink.attempts)
        return attempt in self._finished and attempt not in self._uncertain_attempts

    def _may_start_attempt(self, executor: EpisodeExecutor) -> bool:
        """Whether to submit another attempt: at most the missing episodes, if all running attempts succeed."""
        if self._queue:
            return True
        if self._next >= self._limit.max_attempts and not self._uncertain_attempts:
            return False
        promised = executor.in_flight + sum(payload.outcome.success for payload in self._finished.values())
        ahead = self._next - len(self._sink.attempts)
        # An uncertain attempt blocks writing until another attempt has finished.
        near = ahead < _MAX_ATTEMPTS_AHEAD * self._config.workers or (
            self._uncertain_attempts and not executor.in_flight
        )
        return promised < self.remaining and bool(near)

    def _next_attempt(self) -> int:
        if self._queue:
            return self._queue.pop()
        self._next += 1
        return self._next - 1

    def _mark_lost(self, error: LostJobError) -> None:
        job = error.job
        assert isinstance(job, AttemptJob)
        detail = f"ended its worker {error.tries} times; the last one {error.reason}"
        if job.attempt in self._lost_attempts:
            number = self._lost_attempts[job.attempt].episode
            raise PartialJobError(f"{episode_name(number or 0)} cannot be made again: {error}") from error
        if job.attempt in self._sink.lost_lines:
            if missing_episode(self._sink.attempts, job.attempt) is not None:
                raise PartialJobError(f"attempt {job.attempt} cannot be made again: {error}") from error
        else:
            self._uncertain_attempts.add(job.attempt)
            if (lost := len(self._uncertain_attempts)) >= _MAX_LOST_IN_A_ROW:
                raise PartialJobError(f"{lost} attempts in a row lost their workers, the last one: {error}")
            self._watch.warn(
                f"Attempt {job.attempt} {detail}. It counts as a failure, unless the next attempts end their workers "
                "too."
            )
        self._finished[job.attempt] = AttemptPayload(Attempt(job), Outcome(False, FailureCause.WORKER_LOST, detail))

    def _commit_attempt(self, payload: AttemptPayload) -> None:
        episode = self._sink.episodes if payload.outcome.success else None
        if episode is not None:
            self._publish_episode(payload, episode)
        self._sink.log_attempt(self._attempt_record(payload, episode))
        self.check_retry_limit()

    def check_retry_limit(self) -> None:
        """Raise RetryLimitError if attempts succeed too rarely, and SimulationError if none can succeed."""
        if self._sink.lost_lines:
            # The results of these attempts are still unknown.
            return
        if self.remaining > len(self._lost_attempts) and (
            error := self._limit.stop_error(self._sink.attempts, self._sink.episodes)
        ):
            raise error

    def _restore_lost_episode(self, payload: AttemptPayload) -> None:
        lost = self._lost_attempts[payload.job.attempt]
        if not payload.outcome.success or lost.episode is None:
            raise self._not_reproduced_error(payload, lost.episode or 0)
        self._publish_episode(payload, lost.episode)
        del self._lost_attempts[lost.attempt]

    def _not_reproduced_error(self, payload: AttemptPayload, episode: int) -> DatasetError:
        return DatasetError(
            f"{self._sink.path}: attempt {payload.job.attempt} was recorded as {episode_name(episode)}, but fails now "
            f"({payload.outcome.cause}): this machine or its packages differ from the machine of the recording"
        )

    def _log_restored_attempt(self, payload: AttemptPayload) -> None:
        number = missing_episode(self._sink.attempts, payload.job.attempt)
        if payload.outcome.success and number is None:  # the original attempt had lost its workers
            detail = (
                "its line in the ledger was lost; the repetition succeeded, but counts as a failure, because the "
                "numbers of later episodes do not include it"
            )
            payload = replace(payload, outcome=Outcome(False, FailureCause.WORKER_LOST, detail), files={})
        episode = number if payload.outcome.success else None
        if episode is not None:
            self._publish_episode(payload, episode)
        elif number is not None and number < self._sink.episodes and len(self._sink.lost_lines) == 1:
            # Later episodes exist, and no other attempt can have given this episode.
            raise self._not_reproduced_error(payload, number)
        self._sink.log_attempt(self._attempt_record(payload, episode))
        self.check_retry_limit()

    def _publish_episode(self, payload: AttemptPayload, episode: int) -> None:
        self._sink.publish_episode(self._episode_record(payload, episode), payload.files)

    def _episode_record(self, payload: AttemptPayload, episode: int) -> EpisodeRecord:
        return episode_record(self._config, payload, episode)

    def _attempt_record(self, payload: AttemptPayload, episode: int | None) -> AttemptRecord:
        return attempt_record(payload, episode)

    def _compare_renderers(self, payload: AttemptPayload) -> None:
        """Warn if workers render with different OpenGL drivers, which give different image bytes."""
        if self._renderer and payload.renderer and payload.renderer != self._renderer:
            self._watch.warn(
                f"Workers render with different OpenGL ({self._renderer}; {payload.renderer}): "
                "the bytes of an image depend on the worker that rendered it."
            )
        self._renderer = payload.renderer or self._renderer

    def _report_progress(self) -> None:
        self._watch.progress(self.complete_episodes, self._config.episodes, len(self._sink.attempts))
