"""Prove a task: its expert's rate, and that nothing else reaches its goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..attempt.engine import demonstrate
from ..attempt.sampling import sample
from ..attempt.simulators import Simulators
from ..errors import SimulationError
from ..progress import Progress
from ..session import Session
from ..trials import run_batch
from ..types import EpisodeJob
from .checks import Check, check_near_misses, check_open_fingers, check_program_fits, check_reach, check_still

# How often the checks that are to fail are tried.
_FEW = 3


def prove(session: Session, least: float, progress: Progress) -> dict[str, Any]:
    """Try a task as often as the config has `episodes`, and look for other ways to its goal.

    Args:
        least: the share of attempts in which its expert has to reach the goal.

    Returns:
        JSON-ready: ok, task, rig, n, n_success, success_rate, wilson95, causes, recovered, core_seconds_per_trial,
        checks, trials (those that failed).

    Raises:
        InterruptedJobError: stopped by the user.
    """
    config = session.config
    report = run_batch(session, (), progress)
    rate = report["success_rate"]
    low, high = report["wilson95"]
    counted = f"{report['n_success']} of {report['n']} succeed, 95 % interval {low:.1%} to {high:.1%}"
    told = f"{counted}; at least {least:.0%} is needed"
    checks = [check_program_fits(config.task), Check("expert", rate >= least, rate, told)]
    few = min(_FEW, config.episodes)
    with Simulators(session.without_meshes()) as simulators:
        checks.append(check_reach(simulators.of(EpisodeJob(config.seed, 0))))
        checks.append(check_still(simulators, config.seed, few))
        checks.append(check_open_fingers(simulators, config.seed, few))
        checks.append(_near_misses(simulators, report))
    return {
        "ok": all(check.ok is not False for check in checks),
        **{key: report[key] for key in _KEPT},
        "checks": [asdict(check) for check in checks],
        "trials": [trial for trial in report["trials"] if not trial["outcome"]["success"]],
    }


_KEPT = (
    "task", "rig", "seed", "n", "n_success", "success_rate", "wilson95", "causes", "recovered", "seconds",
    "core_seconds_per_trial",
)  # fmt: skip


def _near_misses(simulators: Simulators, report: Mapping[str, Any]) -> Check:
    won = next((trial for trial in report["trials"] if trial["outcome"]["success"]), None)
    if won is None:
        return Check("near_misses", None, None, "no attempt succeeded that things could be put off from")
    job = EpisodeJob(won["seed"], won["trial"])
    simulator = simulators.of(job)
    return check_near_misses(simulator, demonstrate(simulator, sample(simulator, job)))


def require_proof(report: Mapping[str, Any]) -> None:
    """Make sure that every check passed.

    Raises:
        SimulationError: one did not.
    """
    failed = [check for check in report["checks"] if check["ok"] is False]
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise SimulationError(f"task {report['task']!r}: {first['name']}: {first['detail']}{more}")
