"""Record corrections: trials of a policy that fail, which the expert completes.

Workers and the order of writing are the same as in a recording, see `recording.collect`. A trial whose worker is lost
gets a line in the ledger. Attempt k of the dataset is trial k of `yamsim eval` with the same seed.
"""

from __future__ import annotations

import functools
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

from ..core.attempt_data import Attempt, AttemptJob, AttemptPayload, FailureCause, Outcome
from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.dataset.records import AttemptRecord, EpisodeRecord, attempt_record, episode_record
from ..core.dataset.writing.staged_writer import EpisodeWriter
from ..core.errors import PartialJobError, count_noun
from ..core.workers.executors import LostJobError
from ..core.workers.process_pool import ProcessPool
from ..core.workers.stop_request import StopRequest
from ..correction_record import POLICY_SUCCEEDED
from ..policies.evaluate.policy_choice import PolicyChoice
from ..policies.evaluate.policy_trial import POLICY_FAULT_ENDS
from ..recording.collect import Collector, EpisodeExecutor, RecordCallbacks
from ..recording.executor_factories import ExecutorFactory
from ..recording.recorder import RecordReport, fill_dataset, require_recordable
from ..recording.recording_output import RecordingOutput
from .correction_runner import CorrectionPayload, CorrectionRunner
from .takeover import require_one_rigid_object

CORRECTION_SOURCE = "correct"  # value of `source` in the records of episodes

_MAX_TRIALS_AHEAD = 4  # trials per worker beyond the oldest unwritten one; limits the episodes in memory


class CorrectionCollector(Collector):
    """Writes the trials of a policy: corrections that succeed as episodes, and a line of the ledger for each trial."""

    def __init__(
        self, config: RecordConfig, sink: EpisodeWriter, callbacks: RecordCallbacks, stop: StopRequest
    ) -> None:
        # A failed correction never shows that all attempts must fail.
        super().__init__(config, sink, callbacks, stop, lambda cause, first: False)

    @property
    def attempts(self) -> list[AttemptRecord]:
        """The trials so far, in order."""
        return self._sink.attempts

    @property
    def remaining(self) -> int:
        """Number of trials without a line in the ledger."""
        return max(0, self._config.episodes - len(self._sink.attempts))

    @property
    def attempts_needed(self) -> int:
        """Number of trials that are still to be run: those that remain, and lost ones that run again."""
        return self.remaining + len(self._lost_trials)

    @property
    def _lost_trials(self) -> set[int]:
        return self._lost_attempts.keys() | self._sink.lost_lines

    def describe_progress(self) -> str:
        """Return how many trials are done, as a clause for messages."""
        return f"{len(self._sink.attempts)} of {count_noun(self._config.episodes, 'trial')} are done"

    def check_retry_limit(self) -> None:
        """Do nothing: failed trials are not repeated."""

    def _may_start_attempt(self, executor: EpisodeExecutor) -> bool:
        ahead = self._next - len(self._sink.attempts)
        return bool(self._queue) or (
            self._next < self._config.episodes and ahead < _MAX_TRIALS_AHEAD * self._config.workers
        )

    def _mark_lost(self, error: LostJobError) -> None:
        job = error.job
        assert isinstance(job, AttemptJob)
        if job.attempt in self._lost_trials:
            raise PartialJobError(f"trial {job.attempt} cannot be run again: {error}") from error
        detail = f"its worker {error.reason}, in each of {error.tries} tries"
        self._finished[job.attempt] = AttemptPayload(Attempt(job), Outcome(False, FailureCause.WORKER_LOST, detail))

    def _episode_record(self, payload: AttemptPayload, episode: int) -> EpisodeRecord:
        assert isinstance(payload, CorrectionPayload), "only corrections succeed"
        update = {"source": CORRECTION_SOURCE, "correction": payload.correction}
        return episode_record(self._config, payload, episode).model_copy(update=update)

    def _attempt_record(self, payload: AttemptPayload, episode: int | None) -> AttemptRecord:
        record = attempt_record(payload, episode)
        if not isinstance(payload, CorrectionPayload) or payload.ledger_outcome is None:
            return record
        return record.model_copy(update={"outcome": payload.ledger_outcome})

    def _report_progress(self) -> None:
        self._watch.progress(len(self._sink.attempts), self._config.episodes, self._sink.episodes)


def correction_executor(
    session: Session, workers: int, choice: PolicyChoice, rewind_s: float, job_seconds: float
) -> EpisodeExecutor:
    """Return an executor of trials, with their corrections, in processes of this machine.

    Args:
        rewind_s: as in `takeover_frame`.
        job_seconds: longest time for a trial with its correction, s, after which its worker is replaced.
    """
    return ProcessPool(functools.partial(CorrectionRunner, session, choice, rewind_s), workers, job_seconds)


@dataclass(frozen=True)
class CorrectionReport:
    """State of the dataset after a run.

    Attributes:
        recorded: the run, and the episodes of the dataset.
        policy: name of the policy.
        trials: number of trials in the dataset.
        policy_succeeded: trials in which there was nothing to correct.
        policy_faults: cause -> number, for trials that ended because the policy or its worker failed.
        not_corrected: cause -> number, for all other trials without a correction.
    """

    recorded: RecordReport
    policy: str
    trials: int
    policy_succeeded: int
    policy_faults: dict[str, int]
    not_corrected: dict[str, int]

    def data(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        recorded = self.recorded
        return {
            "policy": self.policy,
            "trials": self.trials,
            "policy_succeeded": self.policy_succeeded,
            "corrected": recorded.episodes,
            "not_corrected": self.not_corrected,
            "policy_faults": self.policy_faults,
            "seconds": round(recorded.seconds, 3),
            "path": str(recorded.path),
            "moved_aside": str(recorded.moved_aside) if recorded.moved_aside else None,
        }

    def describe(self) -> str:
        """Return the report as a sentence."""
        faults = sum(self.policy_faults.values())
        return (
            f"{count_noun(self.recorded.episodes, 'correction')} of {count_noun(self.trials, 'trial')} in "
            f"{self.recorded.path}; the policy succeeded in {self.policy_succeeded}, "
            f"{sum(self.not_corrected.values())} were not corrected, and {faults} ended with a fault of the policy or "
            f"its worker ({self.recorded.seconds:.1f} s)"
        )


def correct(
    session: Session,
    policy: str,
    output: RecordingOutput,
    executor_factory: ExecutorFactory,
    callbacks: RecordCallbacks,
    stop: StopRequest,
) -> CorrectionReport:
    """Run `config.episodes` trials of a policy, and write a dataset of the corrections of those that fail.

    Args:
        policy: name of the policy, for the report.
        executor_factory: runs the trials, usually `correction_executor` with its last three arguments bound.
        callbacks: `progress` gets the numbers of finished trials, of requested trials, and of corrections.

    Raises:
        UsageError: the expert cannot take over in this task, or the policy cannot be loaded.
    """
    began = time.monotonic()
    require_one_rigid_object(session.config.task)
    collectors: list[CorrectionCollector] = []

    def make_collector(config: RecordConfig, sink: EpisodeWriter) -> Collector:
        collectors.append(CorrectionCollector(config, sink, callbacks, stop))
        return collectors[-1]

    session = require_recordable(session, callbacks)
    recorded = fill_dataset(session, output, executor_factory, make_collector, callbacks, stop, began)
    causes = Counter(str(line.outcome.cause) for line in collectors[-1].attempts if line.episode is None)
    faults = {end.value for end in POLICY_FAULT_ENDS} | {FailureCause.WORKER_LOST.value}
    return CorrectionReport(
        recorded,
        policy,
        len(collectors[-1].attempts),
        causes.pop(POLICY_SUCCEEDED, 0),
        {cause: number for cause, number in causes.items() if cause in faults},
        {cause: number for cause, number in causes.items() if cause not in faults},
    )


def require_corrections(report: CorrectionReport) -> None:
    """Raise PartialJobError if the dataset has no episode, with the reason."""
    if report.recorded.episodes:
        return
    trials = count_noun(report.trials, "trial")
    if report.policy_succeeded == report.trials:
        raise PartialJobError(
            f"nothing to correct: {report.policy} succeeded in all of {trials}, so {report.recorded.path} has no "
            "episodes; give a larger --n with --resume, or a harder task"
        )
    found = {"policy succeeded": report.policy_succeeded, **report.policy_faults, **report.not_corrected}
    counts = ", ".join(f"{what} {number}" for what, number in found.items() if number)
    raise PartialJobError(f"no trial was corrected ({counts}), so {report.recorded.path} has no episodes")
