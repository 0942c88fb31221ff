"""Evaluation of a policy: trials in worker processes, their statistics, and films of failures."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import OutcomeRecord, plain
from yamsim_cli.core.episode.engine import repeat
from yamsim_cli.core.episode.rules import REPEATED_RULES
from yamsim_cli.core.episode.simulator import cast_for
from yamsim_cli.core.episode.trials import FilmedTrial, TrialFilmer, TrialFilms, film_jobs, run_trials, tally, what_ran
from yamsim_cli.core.errors import PartialJobError
from yamsim_cli.core.progress import Progress
from yamsim_cli.core.statistics import spread, wilson95
from yamsim_cli.core.types import Actions, Attempt, EpisodeJob, Outcome
from yamsim_cli.core.workers.executor import LostJobError
from yamsim_cli.core.workers.pool import JOB_SECONDS
from yamsim_cli.core.workers.processes import WorkerPool

from .choice import PolicyChoice
from .policy_trial import MEASURED, Ended, TrialResult, TrialRunner


@dataclass(frozen=True)
class Evaluation:
    """All trials of a policy, in their order.

    Attributes:
        seconds: real time of all trials, s.
        instances: which thing has which role in each trial, see `instance_of`.
    """

    choice: PolicyChoice
    results: tuple[TrialResult, ...]
    seconds: float
    instances: tuple[str, ...]


def evaluate(
    session: Session, choice: PolicyChoice, progress: Progress, trial_seconds: float = JOB_SECONDS
) -> Evaluation:
    """Run trials of a policy, as many as the config's `episodes`, from the starts of `trials` with the same seed.

    Args:
        trial_seconds: real time after which a worker that does not finish its trial is ended, s.

    Raises:
        UsageError, ResourceError: the policy cannot be made.
        InterruptedJobError: stopped by the user.
    """
    began = time.monotonic()
    config = session.config
    n = config.episodes
    factory = functools.partial(TrialRunner, session, choice)
    with WorkerPool[EpisodeJob, TrialResult](factory, min(config.workers, n), trial_seconds) as pool:
        results = run_trials(pool, config.seed, n, progress, _lost)
    results.sort(key=lambda result: result.attempt.job.attempt)
    instances = tuple(instance_of(session, result.attempt.job) for result in results)
    return Evaluation(choice, tuple(results), time.monotonic() - began, instances)


def instance_of(session: Session, job: EpisodeJob) -> str:
    """The kinds of a trial's things, such as "object banana, plate"."""
    kinds = cast_for(session, job).kinds
    return ", ".join(name if name == kind else f"{name} {kind}" for name, kind in sorted(kinds.items()))


def by_instance(evaluation: Evaluation) -> list[dict[str, Any]]:
    """For each instance, JSON-ready: instance, n, n_success, success_rate, wilson95, policy_s."""
    rows = []
    for name in dict.fromkeys(sorted(evaluation.instances)):
        found = [result for result, own in zip(evaluation.results, evaluation.instances, strict=True) if own == name]
        n, succeeded = len(found), sum(result.outcome.success for result in found)
        rows.append(
            {
                "instance": name,
                "n": n,
                "n_success": succeeded,
                "success_rate": succeeded / n,
                "wilson95": wilson95(succeeded, n),
                "policy_s": spread([seconds for result in found for seconds in result.seconds]),
            }
        )
    return rows


def _chunks(results: Sequence[TrialResult], tick: float) -> dict[str, Any]:
    """Counts of all trials: chunks, actions, stale actions, and the time without an action for it, s."""
    counts = [result.count for result in results]
    return {
        "chunks": sum(count.chunks for count in counts),
        "actions": sum(count.actions for count in counts),
        "stale": sum(count.stale for count in counts),
        "waited_s": round(sum(count.waited for count in counts) * tick, 6),
    }


def _lost(lost: LostJobError) -> TrialResult:
    assert isinstance(lost.job, EpisodeJob)
    error = f"its worker {lost.reason}, in each of {lost.tries} tries"
    outcome = OutcomeRecord.of(Outcome(False)).model_copy(update={"cause": Ended.LOST.value, "detail": error})
    return TrialResult(Attempt(lost.job), outcome, Ended.LOST, error)


def summary(evaluation: Evaluation, config: RecordConfig, thresholds: Sequence[float]) -> dict[str, Any]:
    """An evaluation as JSON-ready data: policy, stats, rig, task, grasp, arms, seed, seconds, trials.

    Args:
        thresholds: m, by which the outcomes are scored beside the task's own.
    """
    results, tick = evaluation.results, config.task.timing.tick
    calls = [seconds for result in results for seconds in result.seconds]
    stats = {
        **tally(
            [result.outcome for result in results],
            config.task,
            thresholds,
            [not result.error for result in results],
        ),
        "ended": dict(Counter(result.ended.value for result in results)),
        "policy_s": spread(calls),
        "chunks": _chunks(results, tick),
        "by_instance": by_instance(evaluation),
        "slower_than_real_time": sum(seconds > tick for seconds in calls) / len(calls) if calls else None,
    }
    return {
        "policy": evaluation.choice.name,
        "stats": stats,
        **what_ran(config),
        "end_rule": evaluation.choice.end.value,
        "tick_s": tick,
        "seconds": evaluation.seconds,
        "ticks_per_second": sum(result.ticks for result in results) / evaluation.seconds,
        "trials": [_trial(result, tick) | {"instance": evaluation.instances[k]} for k, result in enumerate(results)],
    }


def require_run(report: Mapping[str, Any]) -> None:
    """Make sure that an evaluation measured the policy's success.

    Args:
        report: of `summary`.

    Raises:
        PartialJobError: no trial came to its end.
    """
    ended = report["stats"]["ended"]
    if not any(Ended(how) in MEASURED for how in ended):
        first = report["trials"][0]
        counts = ", ".join(f"{how} {count}" for how, count in ended.items())
        raise PartialJobError(
            f"no trial of {report['policy']} came to its end ({counts}), so its success was not measured; "
            f"trial {first['trial']}: {first['error'] or first['outcome']['detail']}"
        )


def _trial(result: TrialResult, tick: float) -> dict[str, Any]:
    return {
        "trial": result.attempt.job.attempt,
        "seed": result.attempt.job.seed,
        "ended": result.ended.value,
        "error": result.error or None,
        "traceback": result.traceback or None,
        "simulated_s": round(result.ticks * tick, 6),
        "policy_s": spread(result.seconds),
        "outcome": plain(result.outcome),
        "layout": {name: list(pose) for name, pose in result.attempt.places.items()},
    }


@dataclass(frozen=True, eq=False)
class _FilmJob:
    attempt: Attempt
    actions: Actions


class PolicyFilmer(TrialFilmer):
    """Repeats a policy's actions, and renders them."""

    def run(self, film: _FilmJob) -> list[bytes]:
        """The trial's frames as JPEGs."""
        simulator = self._simulators.of(film.attempt.job)
        return self._film(simulator, repeat(simulator, film.attempt, film.actions, REPEATED_RULES))


def shown(results: Sequence[TrialResult], limit: int, *, successes: bool) -> list[TrialResult]:
    """The trials that are filmed, see `film`."""
    acted = [result for result in results if result.actions is not None]
    failed = [result for result in acted if not result.outcome.success]
    return (acted if successes else failed or acted)[:limit]


def film(
    evaluation: Evaluation,
    limit: int,
    films: TrialFilms,
    session: Session,
    progress: Progress,
    *,
    successes: bool = False,
) -> list[FilmedTrial]:
    """Film trials in which something acted: the failures, or the successes if there are no failures.

    Args:
        limit: number of films at most.
        successes: film failures and successes, in the order of the trials.

    Raises:
        InterruptedJobError: stopped by the user; finished films stay.
        ResourceError: nothing can be rendered here, or the films cannot be written.
    """
    config = session.config
    tick = config.task.timing.tick
    chosen = shown(evaluation.results, limit, successes=successes)
    jobs = [_FilmJob(result.attempt, result.actions) for result in chosen if result.actions is not None]
    if not jobs:
        return []
    factory = functools.partial(PolicyFilmer, session)
    return film_jobs(factory, [_trial(result, tick) for result in chosen], jobs, films, config.workers, progress)
