from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from yamsim_cli.core.attempt_data import ActionSequence, Attempt, AttemptJob, Outcome
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import OutcomeRecord, record_data
from yamsim_cli.core.episode.episode_rules import REPLAY_RULES
from yamsim_cli.core.episode.execution import simulate_actions
from yamsim_cli.core.episode.simulator import sample_roles_for
from yamsim_cli.core.errors import PartialJobError
from yamsim_cli.core.progress import Progress
from yamsim_cli.core.statistics import summarize_values, wilson_interval_95
from yamsim_cli.core.workers.executors import LostJobError
from yamsim_cli.core.workers.process_pool import ProcessPool
from yamsim_cli.core.workers.worker_pool import JOB_TIMEOUT
from yamsim_cli.trials import (
    FilmedTrial,
    TrialFrameRenderer,
    TrialVideoWriter,
    count_outcomes,
    film_jobs,
    run_trials,
    trial_settings,
)

from ..action_chunks import ChunkSettings, ChunkStats
from .policy_choice import PolicyChoice
from .policy_trial import MEASURED_ENDS, TrialEnd, TrialResult, TrialRunner, trial_rules


@dataclass(frozen=True)
class Evaluation:
    """Results of all trials of a policy, their real time, s, and objects, such as "object banana, plate"."""

    choice: PolicyChoice
    results: tuple[TrialResult, ...]
    seconds: float
    object_instances: tuple[str, ...]


def evaluate(
    session: Session, choice: PolicyChoice, progress: Progress, trial_seconds: float = JOB_TIMEOUT
) -> Evaluation:
    """Run `config.episodes` trials of a policy, from the same starts as `yamsim trials` with that seed.

    A worker is terminated if a trial takes more than `trial_seconds` of real time.
    """
    began = time.monotonic()
    config = session.config
    n = config.episodes
    factory = functools.partial(TrialRunner, session, choice)
    with ProcessPool[AttemptJob, TrialResult](factory, min(config.workers, n), trial_seconds) as pool:
        results = run_trials(pool, config.seed, n, progress, _lost_trial)
    results.sort(key=lambda result: result.attempt.job.attempt)
    instances = tuple(describe_objects(session, result.attempt.job) for result in results)
    return Evaluation(choice, tuple(results), time.monotonic() - began, instances)


def describe_objects(session: Session, job: AttemptJob) -> str:
    """Return the objects of a trial with their roles, such as "object banana, plate"."""
    kinds = sample_roles_for(session, job).config_names
    return ", ".join(name if name == kind else f"{name} {kind}" for name, kind in sorted(kinds.items()))


def rates_by_objects(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Return JSON data per assignment of objects (`instance`): success rate, its 95 % interval, and inference times."""
    rows = []
    for name in dict.fromkeys(sorted(evaluation.object_instances)):
        found = [
            result for result, own in zip(evaluation.results, evaluation.object_instances, strict=True) if own == name
        ]
        calls = [seconds for result in found for seconds in result.seconds]
        rows.append({"instance": name, **success_figures([result.outcome.success for result in found], calls)})
    return rows


def success_figures(successes: Sequence[bool], calls: Sequence[float]) -> dict[str, Any]:
    """Return success rate, its 95 % interval, and inference times of one or more trials as JSON data.

    Args:
        calls: duration of each inference of these trials, s.
    """
    n, succeeded = len(successes), sum(successes)
    return {
        "n": n,
        "n_success": succeeded,
        "success_rate": succeeded / n,
        "wilson95": wilson_interval_95(succeeded, n),
        "policy_s": summarize_values(calls),
    }


def _mean_offset(offsets: Sequence[tuple[float, ...] | None]) -> dict[str, Any] | None:
    """Return mean and standard deviation of offsets by axis, m, and their number; None without offsets."""
    rows = np.array([offset for offset in offsets if offset is not None])
    if not len(rows):
        return None
    return {"n": len(rows), "mean": rows.mean(axis=0).tolist(), "deviation": rows.std(axis=0).tolist()}


def chunk_totals(counts: Sequence[ChunkStats], tick: float) -> dict[str, Any]:
    """Return the sums of all trials' counts as JSON data.

    Args:
        tick: length of a control tick, s.
    """
    return {
        "chunks": sum(count.chunks for count in counts),
        "actions": sum(count.actions for count in counts),
        "stale": sum(count.stale for count in counts),
        "waited_s": round(sum(count.waited for count in counts) * tick, 6),
    }


def share_slower_than(tick: float, calls: Sequence[float]) -> float | None:
    """Return the share of a policy's answers that took longer than a control tick, s; None without answers."""
    return sum(seconds > tick for seconds in calls) / len(calls) if calls else None


def _lost_trial(lost: LostJobError) -> TrialResult:
    assert isinstance(lost.job, AttemptJob)
    error = f"its worker {lost.reason}, in each of {lost.tries} tries"
    outcome = OutcomeRecord.from_outcome(Outcome(False)).model_copy(
        update={"cause": TrialEnd.LOST.value, "detail": error}
    )
    return TrialResult(Attempt(lost.job), outcome, TrialEnd.LOST, error)


def evaluation_report(evaluation: Evaluation, config: RecordConfig, thresholds: Sequence[float]) -> dict[str, Any]:
    """Return an evaluation as JSON data.

    Args:
        thresholds: distances, m, for which success rates are computed, besides the task's own threshold.
    """
    results, tick = evaluation.results, config.task.timing.tick_seconds
    calls = [seconds for result in results for seconds in result.seconds]
    stats = {
        **count_outcomes(
            [result.outcome for result in results],
            config.task,
            thresholds,
            [not result.error for result in results],
        ),
        "ended": dict(Counter(result.ended.value for result in results)),
        "policy_s": summarize_values(calls),
        "chunks": chunk_totals([result.chunk_stats for result in results], tick),
        "by_instance": rates_by_objects(evaluation),
        "offset_m": _mean_offset([result.offset for result in results]),
        "offset_in_hand_m": _mean_offset([result.offset_in_hand for result in results]),
        "slower_than_real_time": share_slower_than(tick, calls),
    }
    return {
        "policy": evaluation.choice.name,
        "stats": stats,
        **trial_settings(config),
        "end_rule": evaluation.choice.end.value,
        "settings": report_settings(evaluation, config),
        "tick_s": tick,
        "seconds": evaluation.seconds,
        "ticks_per_second": sum(result.ticks for result in results) / evaluation.seconds,
        "trials": [
            _trial_report(result, tick) | {"instance": evaluation.object_instances[k]}
            for k, result in enumerate(results)
        ],
    }


def report_settings(evaluation: Evaluation, config: RecordConfig) -> dict[str, Any]:
    """Return what else decides the trials, as JSON data. `execute` is the policy's own value if none was given."""
    choice = evaluation.choice
    limit = (trial_rules(config, choice).max_ticks or 0) * config.task.timing.tick_seconds
    return {
        **policy_settings(choice, [result.chunking for result in evaluation.results], limit),
        "size_px": list(config.image.size_px),
        "quality": config.render.name,
        "randomization": config.randomization.name,
        "randomized": list(config.randomization.varied_parts),
        "camera_effects": [entry.model_dump(mode="json") for entry in config.camera_effects],
    }


def policy_settings(choice: PolicyChoice, used: Sequence[ChunkSettings | None], time_limit: float) -> dict[str, Any]:
    """Return how a policy was called, as JSON data.

    Args:
        used: of each trial; None if it did not begin.
        time_limit: longest trial, simulated s.
    """
    chunking = next((one for one in used if one is not None), choice.chunking)
    return {
        "policy_arguments": dict(choice.arguments),
        "policy_config": choice.mapping,
        "execute": chunking.execute,
        "ensemble": chunking.ensemble,
        "latency_s": "measured" if chunking.latency is None else chunking.latency,
        "time_limit_s": round(time_limit, 6),
        "policy_timeout_s": choice.call_seconds,
    }


def require_measured_trials(report: Mapping[str, Any]) -> None:
    """Raise PartialJobError if all trials ended before they measured the policy's success."""
    ended = report["stats"]["ended"]
    if not any(TrialEnd(how) in MEASURED_ENDS for how in ended):
        first = report["trials"][0]
        counts = ", ".join(f"{how} {count}" for how, count in ended.items())
        raise PartialJobError(
            f"no trial of {report['policy']} was completed ({counts}), so its success was not measured; "
            f"trial {first['trial']}: {first['error'] or first['outcome']['detail']}"
        )


def _trial_report(result: TrialResult, tick: float) -> dict[str, Any]:
    return {
        "trial": result.attempt.job.attempt,
        "seed": result.attempt.job.seed,
        "ended": result.ended.value,
        "error": result.error or None,
        "traceback": result.traceback or None,
        "simulated_s": round(result.ticks * tick, 6),
        "policy_s": summarize_values(result.seconds),
        "outcome": record_data(result.outcome),
        "offset_m": result.offset,
        "offset_in_hand_m": result.offset_in_hand,
        "layout": {name: list(pose) for name, pose in result.attempt.object_places.items()},
    }


@dataclass(frozen=True, eq=False)
class _FilmJob:
    attempt: Attempt
    actions: ActionSequence


class PolicyFilmer(TrialFrameRenderer):
    """Films trials of a policy by simulating the recorded actions again."""

    def run(self, film: _FilmJob) -> list[bytes]:
        """Return the frames of a trial as JPEGs."""
        simulator = self._simulators.get(film.attempt.job)
        return self._render_jpegs(simulator, simulate_actions(simulator, film.attempt, film.actions, REPLAY_RULES))


def trials_to_film(results: Sequence[TrialResult], limit: int, *, successes: bool) -> list[TrialResult]:
    """Return up to `limit` failures, or successes if none failed. With `successes`, return both."""
    acted = [result for result in results if result.actions is not None]
    failed = [result for result in acted if not result.outcome.success]
    return (acted if successes else failed or acted)[:limit]


def film_evaluation(
    evaluation: Evaluation,
    limit: int,
    films: TrialVideoWriter,
    session: Session,
    progress: Progress,
    *,
    successes: bool = False,
) -> list[FilmedTrial]:
    """Film trials with actions: failures, or successes if no trial failed. With `successes`, film both in order."""
    config = session.config
    tick = config.task.timing.tick_seconds
    chosen = trials_to_film(evaluation.results, limit, successes=successes)
    jobs = [_FilmJob(result.attempt, result.actions) for result in chosen if result.actions is not None]
    if not jobs:
        return []
    factory = functools.partial(PolicyFilmer, session)
    return film_jobs(factory, [_trial_report(result, tick) for result in chosen], jobs, films, config.workers, progress)
