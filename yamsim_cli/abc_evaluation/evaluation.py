"""Evaluation of a policy at `put_bottles`: the reports of `yamsim eval`, from the trials of ABC's evaluation."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from ..core.attempt_data import AttemptJob
from ..core.errors import UsageError
from ..core.files.resources import Locations
from ..core.progress import Progress
from ..core.statistics import summarize_values
from ..core.workers.executors import LostJobError
from ..core.workers.process_pool import ProcessPool
from ..kitchen_scenes import ABC_TASK
from ..policies.evaluate.compare import compare_with_others, read_compared_reports
from ..policies.evaluate.evaluation import chunk_totals, policy_settings, share_slower_than, success_figures
from ..policies.evaluate.policy_choice import PolicyChoice
from ..policies.evaluate.policy_trial import TrialEnd
from ..policies.policy_faults import PolicyFault
from ..trials import run_trials
from .environment import ACTION_SECONDS, BOTTLES, SIDES
from .trial import RIG, BottlesResult, BottlesTrialRunner, max_actions

DEFAULT_SEED = 20260511  # Source: amazon-far/abc e5e1fbc, `SimEvalConfig.seed` of abc_minimal/config.py
DEFAULT_SIZE = 224, 168  # px, width and height of images. Source: as above

_BOTTLES_LEFT = "bottles_left"  # cause of a failure in which the policy is not at fault


@dataclass(frozen=True)
class BottlesEvaluation:
    """What is evaluated: trial k starts from seed `seed` + k.

    Attributes:
        folder: ABC's model files, see `model_files.find_model_folder`.
        size: width and height of images, px.
        trial_seconds: real time after which a trial's worker counts as hung, s.
        watch: returns a progress display for the trials of one policy.
    """

    folder: Path
    locations: Locations
    n: int
    seed: int
    workers: int
    size: tuple[int, int]
    trial_seconds: float
    watch: Callable[[], AbstractContextManager[Progress]]

    def __post_init__(self) -> None:
        for flag, value, least in (("--seed", self.seed, 0), ("--workers", self.workers, 1)):
            if value < least:
                raise UsageError(f"{flag} {value} is not valid: give a whole number, at least {least}")

    def evaluate(self, choice: PolicyChoice, others: Sequence[str] = ()) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """Evaluate a policy, and return its report with `compared`, and the reports of the others.

        Args:
            others: policies to compare with, or reports `FILE.json` of the same trials.

        Raises:
            UsageError: a report is unreadable or of other trials, or a policy does not exist.
        """
        known = read_compared_reports(others, self._settings())
        report = self._run(choice)
        return report, compare_with_others(report, others, known, lambda name: self._run(choice.compared_with(name)))

    def _settings(self) -> dict[str, Any]:
        return {"rig": RIG, "task": ABC_TASK, "grasp": "contact", "arms": list(SIDES), "seed": self.seed}

    def _run(self, choice: PolicyChoice) -> dict[str, Any]:
        began = time.monotonic()
        factory = functools.partial(BottlesTrialRunner, self.folder, choice, self.size, self.locations)
        workers = min(self.workers, self.n)
        with (
            self.watch() as progress,
            ProcessPool[AttemptJob, BottlesResult](factory, workers, self.trial_seconds) as pool,
        ):
            results = run_trials(pool, self.seed, self.n, progress, _lost_trial)
        results.sort(key=lambda result: result.job.attempt)
        seconds = time.monotonic() - began
        return {
            "policy": choice.name,
            "stats": _statistics(results),
            **self._settings(),
            "end_rule": choice.end.value,
            "settings": self._report_settings(choice, results),
            "tick_s": ACTION_SECONDS,
            "seconds": seconds,
            "ticks_per_second": sum(result.actions for result in results) / seconds,
            "trials": [_trial_report(result) for result in results],
        }

    def _report_settings(self, choice: PolicyChoice, results: Sequence[BottlesResult]) -> dict[str, Any]:
        return {
            **policy_settings(choice, [result.chunking for result in results], max_actions(choice) * ACTION_SECONDS),
            "size_px": list(self.size),
            "engine": f"MuJoCo {mujoco.__version__}",
        }


def require_supported_flags(given: Mapping[str, object]) -> None:
    """Raise UsageError if a flag is given that does not apply to ABC's scene.

    Args:
        given: flag -> its value, None if it is not given.
    """
    for flag, value in given.items():
        if value is not None:
            raise UsageError(
                f"{flag} is not for --task {ABC_TASK}, whose scene, starts and success rule are fixed: leave it out"
            )


def _lost_trial(lost: LostJobError) -> BottlesResult:
    assert isinstance(lost.job, AttemptJob)
    fault = PolicyFault(f"its worker {lost.reason}, in each of {lost.tries} tries")
    return BottlesResult(lost.job, lost.job.seed + lost.job.attempt, False, TrialEnd.LOST, fault)


def _statistics(results: Sequence[BottlesResult]) -> dict[str, Any]:
    n, calls = len(results), [seconds for result in results for seconds in result.seconds]
    shared = success_figures([result.success for result in results], calls)
    return {
        **shared,
        "threshold_m": None,
        "rates": {},
        "dxy_m": None,
        "causes": dict(Counter(cause for result in results if (cause := _cause(result)))),
        "recovered": 0,
        "mean_bottles_in_bin": sum(len(result.in_bin) for result in results) / n,
        "mean_most_bottles_in_bin": sum(result.most_in_bin for result in results) / n,
        "ended": dict(Counter(result.ended.value for result in results)),
        "chunks": chunk_totals([result.chunk_stats for result in results], ACTION_SECONDS),
        "by_instance": [{"instance": "", **shared}],
        "offset_m": None,
        "offset_in_hand_m": None,
        "slower_than_real_time": share_slower_than(ACTION_SECONDS, calls),
    }


def _cause(result: BottlesResult) -> str | None:
    if result.success:
        return None
    return result.ended.value if result.fault.text or result.ended is TrialEnd.UNSTABLE else _BOTTLES_LEFT


def _trial_report(result: BottlesResult) -> dict[str, Any]:
    left = [name for name in BOTTLES if name not in result.in_bin]
    told = "" if result.success else f"not in the bin: {', '.join(left)}"
    return {
        "trial": result.job.attempt,
        "seed": result.job.seed,
        "start_seed": result.start_seed,
        "ended": result.ended.value,
        "error": result.fault.text or None,
        "traceback": result.fault.traceback or None,
        "simulated_s": round(result.actions * ACTION_SECONDS, 6),
        "actions": result.actions,
        "policy_s": summarize_values(result.seconds),
        "outcome": {"success": result.success, "cause": _cause(result), "detail": result.fault.text or told},
        "in_bin": list(result.in_bin),
        "most_in_bin": result.most_in_bin,
        "layout": {name: list(place) for name, place in result.places.items()},
        "instance": "",
    }
