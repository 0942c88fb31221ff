"""Verify a dataset: workers make its episodes again, this process tells what differs."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import InterruptedJobError, ranges
from ..progress import Progress
from ..session import Session
from ..workers.processes import WorkerPool
from .remake import ACTIONS, CHECKS, SEED, EpisodeVerifier, Limits, Verdict


def verify(
    episodes: Sequence[tuple[int, Path]],
    session: Session,
    limits: Limits,
    workers: int,
    progress: Progress,
) -> dict[str, Any]:
    """Make episodes of one dataset again and compare, see `remake`.

    Args:
        episodes: number and directory of each.
        session: of the dataset's own config; its meshes matter to images alone.

    Returns:
        JSON-ready: episodes, agree, max_error, first_divergence, divergences, problems, checks, versions_changed,
        skipped, tolerance, seconds.

    Raises:
        InterruptedJobError: stopped by the user.
    """
    began = time.monotonic()
    factory = functools.partial(EpisodeVerifier, session, limits)
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
