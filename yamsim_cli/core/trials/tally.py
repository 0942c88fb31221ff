"""Many trials of one kind: run side by side, and counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from ..config.program_task import ProgramTask
from ..config.recording import RecordConfig
from ..dataset.records import OutcomeRecord
from ..dataset.statistics import spread, wilson95
from ..errors import InterruptedJobError, SimulationError
from ..progress import Progress
from ..types import EpisodeJob
from ..workers.executor import Executor, LostJobError

R = TypeVar("R")


def run_trials(
    pool: Executor[EpisodeJob, R],
    seed: int,
    n: int,
    progress: Progress,
    lost: Callable[[LostJobError], R] | None = None,
) -> list[R]:
    """What the first `n` trials of a seed give, in no particular order.

    Args:
        lost: what a trial gives whose workers died or hung; without it, that is an error.

    Raises:
        InterruptedJobError: stopped by the user; nothing is lost but the time.
        LostJobError: see `lost`.
    """
    results: list[R] = []
    started = 0
    try:
        while len(results) < n:
            while pool.idle and started < n:
                pool.submit(EpisodeJob(seed, started))
                started += 1
            try:
                results.append(pool.result()[1])
            except LostJobError as error:
                if lost is None:
                    raise
                results.append(lost(error))
            progress(len(results), n)
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(results)} of {n} trials; run again to count them all"
        ) from None
    return results


def what_ran(config: RecordConfig) -> dict[str, Any]:
    """What a report says its trials were of, JSON-ready: rig, task, grasp, arms (those that act), seed."""
    return {
        "rig": config.rig.name,
        "task": config.task.name,
        "grasp": config.grasp,
        "arms": [config.rig.arms[k].side for k in config.acting],
        "seed": config.seed,
    }


def tally(
    outcomes: Sequence[OutcomeRecord], task: ProgramTask, thresholds: Sequence[float], valid: Sequence[bool]
) -> dict[str, Any]:
    """Counts and rates of outcomes, JSON-ready.

    Args:
        task: whose goal judged them.
        thresholds: in metres, by which the outcomes are scored beside the task's own, if its goal measures a distance.
        valid: whether an outcome may count as a success at any of them.

    Returns:
        n, n_success, success_rate, wilson95, threshold_m, rates per threshold, dxy_m, causes, recovered (how many of
        the successes needed a second try somewhere).
    """
    n, succeeded = len(outcomes), sum(outcome.success for outcome in outcomes)
    target = task.target_predicate

    def rate(threshold: float) -> float:
        within = (outcome.within(threshold) for outcome in outcomes)
        return sum(near and counts for near, counts in zip(within, valid, strict=True)) / n

    return {
        "n": n,
        "n_success": succeeded,
        "success_rate": succeeded / n,
        "wilson95": wilson95(succeeded, n),
        "threshold_m": target and target.radius,
        "rates": {f"{threshold:g}": rate(threshold) for threshold in thresholds} if target else {},
        "dxy_m": spread([outcome.dxy_m for outcome in outcomes if outcome.dxy_m is not None]),
        "causes": dict(Counter(outcome.cause for outcome in outcomes if outcome.cause)),
        "recovered": sum(bool(outcome.recoveries) for outcome in outcomes if outcome.success),
    }


def require_success(counts: Mapping[str, Any], least: float | None) -> None:
    """Make sure that as many trials succeeded as somebody asks for.

    Args:
        counts: what `tally` returns.
        least: the share of the trials that has to succeed; None for any.

    Raises:
        SimulationError: fewer did.
    """
    if least is not None and counts["success_rate"] < least:
        raise SimulationError(
            f"{counts['n_success']} of {counts['n']} trials succeeded, a share of {counts['success_rate']:.3g}: "
            f"--min-success asks for {least:g}"
        )
