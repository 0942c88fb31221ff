"""Verify a dataset: workers make its episodes again, this process tells what differs."""

from __future__ import annotations

import functools
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..config.record import RecordConfig
from ..dataset.layout import episode_directories
from ..errors import DatasetError, InterruptedJobError, UsageError, ranges
from ..resources import Locations
from .remake import ACTIONS, CHECKS, SEED, EpisodeVerifier, Limits, Verdict
from .workers import WorkerPool

# Called with episodes done and in all.
Progress = Callable[[int, int], None]

_RANGE = re.compile(r"^(?:ep_)?(\d+)(?:-(?:ep_)?(\d+))?$")


def select_episodes(dataset: Path, episodes: str | None, sample: int | None) -> list[tuple[int, Path]]:
    """Number and directory of the episodes to verify, in order.

    Args:
        episodes: such as `0,3,5-9`; None for all.
        sample: how many of all to take, spread evenly over the dataset.

    Raises:
        DatasetError: there is no dataset.
        UsageError: an episode is named that is not there, or that is no name.
    """
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} is not a directory; give the directory that `yamsim record` wrote")
    there = dict(episode_directories(dataset))
    if not there:
        raise DatasetError(f"{dataset} holds no episodes (ep_NNNNNN); give the directory that `yamsim record` wrote")
    numbers = sorted(there)
    if episodes is not None:
        numbers = _parse(episodes, dataset, numbers)
    elif sample is not None and sample < len(numbers):
        step = (len(numbers) - 1) / max(1, sample - 1)
        numbers = [numbers[round(k * step)] for k in range(sample)]
    return [(number, there[number]) for number in numbers]


def _parse(text: str, dataset: Path, there: Sequence[int]) -> list[int]:
    chosen: set[int] = set()
    for part in text.split(","):
        match = _RANGE.match(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last:
            raise UsageError(
                f"--episodes {text!r}: {part.strip()!r} is neither a number nor a range; valid: {ranges(there)}"
            )
        # A range may be longer than any list of it.
        named = [number for number in there if first <= number <= last]
        if len(named) != last - first + 1:
            missing = next(number for number in range(first, last + 1) if number not in set(named))
            raise UsageError(f"--episodes {text!r}: {dataset} has no episode {missing}; valid: {ranges(there)}")
        chosen.update(named)
    return sorted(chosen)


def verify(
    episodes: Sequence[tuple[int, Path]],
    config: RecordConfig,
    locations: Locations,
    meshes: Mapping[str, Path | None],
    limits: Limits,
    workers: int,
    progress: Progress,
) -> dict[str, Any]:
    """Make episodes of one dataset again and compare, see `remake`.

    Args:
        episodes: number and directory of each.
        config: the dataset's own.
        meshes: asset set -> folder of its files, or None for primitives; they matter to images alone.

    Returns:
        JSON-ready: episodes, agree, max_error, first_divergence, divergences, problems, checks, versions_changed,
        skipped, tolerance, seconds.

    Raises:
        InterruptedJobError: stopped by the user.
    """
    began = time.monotonic()
    factory = functools.partial(EpisodeVerifier, config, locations, dict(meshes), limits)
    verdicts: list[Verdict] = []
    waiting = list(reversed(episodes))
    try:
        with WorkerPool[tuple[int, Path], Verdict](factory, min(workers, len(episodes))) as pool:
            while len(verdicts) < len(episodes):
                while pool.idle and waiting:
                    pool.submit(waiting.pop())
                verdicts.append(pool.result()[1])
                progress(len(verdicts), len(episodes))
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(verdicts)} of {len(episodes)} episodes, "
            f"{sum(verdict.agrees for verdict in verdicts)} of which agree"
        ) from None
    verdicts.sort(key=lambda verdict: verdict.episode)
    return _report(verdicts, limits) | {"seconds": round(time.monotonic() - began, 3)}


def _report(verdicts: Sequence[Verdict], limits: Limits) -> dict[str, Any]:
    divergences = [
        {"episode": verdict.episode, "check": check, **asdict(comparison.first)}
        for verdict in verdicts
        for check in CHECKS
        if (comparison := verdict.checks.get(check)) and comparison.first
    ]
    checks = {check: _check_report(verdicts, check) for check in CHECKS}
    remade = [found["max_error"] for check in (SEED, ACTIONS) if (found := checks[check])]
    return {
        "episodes": len(verdicts),
        "agree": sum(verdict.agrees for verdict in verdicts),
        # Images count in other units.
        "max_error": max(remade, default=0.0),
        "first_divergence": divergences[0] if divergences else None,
        "divergences": divergences,
        "problems": [
            {"episode": verdict.episode, "file": file, "problem": problem}
            for verdict in verdicts
            for file, problem in verdict.problems.items()
        ],
        "checks": checks,
        "versions_changed": _versions(verdicts),
        "tolerance": limits.values,
        "image_tolerance": limits.images,
    }


def _check_report(verdicts: Sequence[Verdict], check: str) -> dict[str, Any] | None:
    """One check over all episodes it was made on; None where it was made on none, as when images are left out."""
    found = [verdict.checks[check] for verdict in verdicts if check in verdict.checks]
    reasons = sorted({verdict.skipped[check] for verdict in verdicts if check in verdict.skipped})
    if not found and not reasons:
        return None
    largest: dict[str, float] = {}
    for comparison in found:
        for quantity, apart in comparison.largest.items():
            largest[quantity] = max(largest.get(quantity, 0.0), apart)
    return {
        "episodes": len(found),
        "agree": sum(comparison.first is None for comparison in found),
        "max_error": max(largest.values(), default=0.0),
        "largest": largest,
        "skipped": reasons,
    }


def _versions(verdicts: Sequence[Verdict]) -> list[dict[str, Any]]:
    """What changed since the recording, each with the episodes that it concerns."""
    concerned: dict[tuple[str, str, str], list[int]] = {}
    for verdict in verdicts:
        for name, (then, now) in verdict.changed.items():
            concerned.setdefault((name, then, now), []).append(verdict.episode)
    return [
        {"name": name, "recorded": then, "now": now, "episodes": ranges(numbers)}
        for (name, then, now), numbers in sorted(concerned.items())
    ]
