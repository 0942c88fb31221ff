"""Compare two policies on the same starts: McNemar's test, and the interval of the difference."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.statistics import Z95

_SHARED_KEYS = ("task", "rig", "grasp", "arms", "seed")  # keys of a report that must be equal
_MAX_BYTES = 500_000_000  # largest size of a report's file


def read_compared_reports(others: Sequence[str], settings: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the reports `FILE.json` among `others`, by name.

    Args:
        settings: `_SHARED_KEYS` and their values, of the evaluation that is compared.

    Raises UsageError if a report is unreadable, or of other trials.
    """
    reports = {name: read_report(Path(name)) for name in others if name.endswith(".json")}
    for name, report in reports.items():
        require_same_trials(settings, report, name)
    return reports


def compare_with_others(
    report: dict[str, Any],
    others: Sequence[str],
    known: Mapping[str, dict[str, Any]],
    run: Callable[[str], dict[str, Any]],
) -> list[dict[str, Any]]:
    """Return the reports of `others`, and set `compared` in `report` if there are any.

    Args:
        known: reports that exist already, by name.
        run: evaluates a policy, and returns its report.
    """
    found = [known.get(name) or run(name) for name in others]
    if found:
        report["compared"] = [compare_reports(report, other, name) for name, other in zip(others, found, strict=True)]
    return found


def mcnemar_p_value(only_first: int, only_second: int) -> float:
    """Return the exact two-sided p-value of McNemar's test, or 1 without trials.

    Args:
        only_first, only_second: trials in which only this policy succeeded.
    """
    n, fewer = only_first + only_second, min(only_first, only_second)
    # Integers, because floats overflow from about a thousand trials on.
    as_uneven: int = 2 * sum(math.comb(n, k) for k in range(fewer + 1))
    return min(1.0, float(Fraction(as_uneven, 1 << n)))


def difference_interval_95(only_first: int, only_second: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two success rates on the same `n` trials, -1 to 1.

    Valid for small n. Source: D. G. Bonett and R. M. Price, "Adjusted Wald confidence interval for a difference of
    binomial proportions based on paired data", Journal of Educational and Behavioral Statistics 37 (2012).

    Args:
        only_first, only_second: trials in which only this policy succeeded.
    """
    first, second = (only_first + 1) / (n + 2), (only_second + 1) / (n + 2)
    difference = first - second
    half = Z95 * math.sqrt((first + second - difference**2) / (n + 2))
    return max(-1.0, difference - half), min(1.0, difference + half)


def read_report(path: Path) -> dict[str, Any]:
    """Read a report that `yamsim eval --out` wrote."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise UsageError(
                f"--compare {path}: has {path.stat().st_size} bytes; a report of yamsim eval has at most {_MAX_BYTES}"
            )
        report = json.loads(path.read_bytes())
        for trial in report["trials"]:
            if not isinstance(trial["outcome"]["success"], bool) or not isinstance(trial["layout"], dict):
                raise TypeError("a trial without its outcome")
        missing = [key for key in ("policy", *_SHARED_KEYS) if key not in report]
        missing += [key for key in ("success_rate", "policy_s", "chunks", "by_instance") if key not in report["stats"]]
    except OSError as error:
        raise UsageError(f"--compare {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UsageError(f"--compare {path}: is not a report of yamsim eval --out") from error
    if missing:
        raise UsageError(f"--compare {path}: is not a report of yamsim eval --out: it has no {missing[0]!r}")
    found: dict[str, Any] = report
    return found


def require_same_trials(expected: Mapping[str, Any], report: Mapping[str, Any], name: str) -> None:
    """Refuse two evaluations that differ in task, rig, grasp, arms or seed; `name` is the value of `--compare`."""
    for key in _SHARED_KEYS:
        if expected[key] != report[key]:
            raise UsageError(
                f"--compare {name}: its {key} is {report[key]}, not {expected[key]}: trials cannot be paired"
            )


def compare_reports(first: Mapping[str, Any], second: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Compare two reports trial by trial, and return counts of successes as JSON data.

    `name` is the value of `--compare`, a policy or a file, for error messages.
    `policy` and `success_rate` are of the second report. `difference` is the success rate of the first report minus
    that of the second, with its 95 % interval `difference95` and McNemar's exact `p_value`. `settings_differ` has each
    setting with unequal values, as [first, second].
    """
    require_same_trials(first, second, name)
    one, other = ({(trial["seed"], trial["trial"]): trial for trial in report["trials"]} for report in (first, second))
    if one.keys() != other.keys():
        raise UsageError(
            f"--compare {name}: it has other trials ({len(other)}) than the first ({len(one)}): give the same --n"
        )
    counts = {"both": 0, "only_first": 0, "only_second": 0, "neither": 0}
    for job, trial in one.items():
        if not _is_same_trial_start(trial["layout"], other[job]["layout"]):
            raise UsageError(f"--compare {name}: trial {job[1]} has another start: version or settings differ")
        good = trial["outcome"]["success"], other[job]["outcome"]["success"]
        which = {(True, True): "both", (True, False): "only_first", (False, True): "only_second"}.get(good, "neither")
        counts[which] += 1
    return {
        "policy": second["policy"],
        "success_rate": second["stats"]["success_rate"],
        "n": len(one),
        **counts,
        "difference": (counts["only_first"] - counts["only_second"]) / len(one) if one else 0.0,
        "difference95": difference_interval_95(counts["only_first"], counts["only_second"], len(one)),
        "p_value": mcnemar_p_value(counts["only_first"], counts["only_second"]),
        "settings_differ": _differing_settings(first, second),
    }


def _differing_settings(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, list[Any]]:
    # Reports of older versions have no settings.
    one, other = first.get("settings") or {}, second.get("settings") or {}
    own = {"policy_arguments", "policy_config", "trained_on"}  # of a policy, and not of its trials
    return {key: [one[key], other[key]] for key in one if key in other and key not in own and one[key] != other[key]}


def _is_same_trial_start(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    # Trials with a lost worker have no layout.
    if not one or not other:
        return True
    return one.keys() == other.keys() and all(list(one[name]) == list(other[name]) for name in one)
