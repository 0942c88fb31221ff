"""Combine the check results of a dataset, and compute its summary figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.dataset.checks.context import CheckContext
from ..core.dataset.checks.problem import DatasetProblem, ProblemCollector, count_errors, printable_line
from ..core.dataset.records import AttemptRecord
from ..core.statistics import Coverage, compute_coverage, compute_histogram, summarize_values, wilson_interval_95
from ..correction_record import POLICY_SUCCEEDED
from .checks.dataset_checks import check_dataset, read_ledger
from .checks.episode_facts import EpisodeFacts

CELL_M = 0.05  # m, largest cell width: about the width of a banana


@dataclass(frozen=True)
class CheckResults:
    """Result of checking a dataset.

    Attributes:
        attempts: all attempts at an episode: without trials of `yamsim correct` in which the policy succeeded.
    """

    path: Path
    context: CheckContext
    episodes: Sequence[EpisodeFacts]
    attempts: Sequence[AttemptRecord]
    problems: Sequence[DatasetProblem]

    def restricted(self, numbers: Collection[int]) -> CheckResults:
        """Return the results of the episodes with these numbers, and the problems of the dataset as a whole."""
        episodes = [episode for episode in self.episodes if episode.number in numbers]
        left_out = {episode.name for episode in self.episodes} - {episode.name for episode in episodes}
        problems = [problem for problem in self.problems if problem.episode not in left_out]
        return replace(self, episodes=episodes, problems=problems)


def combine_checks(
    dataset: Path, context: CheckContext, episodes: Sequence[EpisodeFacts], problems: ProblemCollector
) -> CheckResults:
    """Check a dataset as a whole, and add the results of its episodes.

    Args:
        problems: faults that were found before the episode checks.
    """
    attempts = read_ledger(dataset, problems) if context.recorded else []
    found = check_dataset(dataset, context, episodes, attempts, problems)
    found += [problem for episode in episodes for problem in episode.problems]
    found.sort(key=lambda problem: problem.episode)
    attempts = [attempt for attempt in attempts if attempt.outcome.cause != POLICY_SUCCEEDED]
    return CheckResults(dataset, context, episodes, attempts, [*problems.all_problems(), *found])


def summarize_checks(results: CheckResults, thresholds: Sequence[float]) -> dict[str, Any]:
    """Return counts, success rates and distributions of a dataset as JSON data; see docs/checking.md.

    `thresholds` are success distances from the target, m; real recordings and tasks with a goal ignore them.
    """
    episodes, problems = results.episodes, list(results.problems)
    outcomes = [episode.outcome for episode in episodes if episode.outcome]
    dxy = [outcome.dxy_m for outcome in outcomes if outcome.dxy_m is not None]
    dz = [outcome.dz_m for outcome in outcomes if outcome.dz_m is not None]
    if results.context.judged_by_goal or results.context.real:
        thresholds = ()
    hits = {f"{t:g}": sum(is_within_threshold(episode, t, results) for episode in episodes) for t in thresholds}
    records = [episode.record for episode in episodes if episode.record]
    n_errors = count_errors(problems)
    return {
        "path": printable_line(results.path),
        "recorded_by_yamsim": results.context.recorded,
        "real": results.context.real,
        "episodes": len(episodes),
        "frames": sum(episode.frames for episode in episodes),
        "bytes": sum(episode.bytes for episode in episodes),
        "seconds": sum(episode.seconds or 0.0 for episode in episodes),
        "frames_per_episode": _value_range([episode.frames for episode in episodes]),
        "bytes_per_episode": _value_range([episode.bytes for episode in episodes]),
        "success_rate": {t: hit / len(outcomes) if outcomes else None for t, hit in hits.items()},
        "wilson95": {t: wilson_interval_95(hit, len(outcomes)) for t, hit in hits.items()},
        "attempts": _attempt_statistics(results.attempts, thresholds, results.context.max_height),
        "dxy_m": _value_distribution(dxy),
        "dz_m": _value_distribution(dz),
        "workspace": _workspace_statistics(results),
        "cameras": {printable_line(name): list(size) for episode in episodes for name, size in episode.cameras.items()},
        "tasks": sorted({record.task for record in records}),
        "grasps": sorted({record.grasp for record in records}),
        "versions": [dict(found) for found in sorted({tuple(sorted(record.versions.items())) for record in records})],
        "noted_at_import": {
            episode.name: list(map(printable_line, episode.import_faults))
            for episode in episodes
            if episode.import_faults
        },
        "errors": n_errors,
        "warnings": len(problems) - n_errors,
        "problems": [problem.to_json_data() for problem in problems],
    }


def is_within_threshold(episode: EpisodeFacts, threshold: float, results: CheckResults) -> bool:
    """Whether the goal was reached; without a goal, whether the object ended within `threshold` m of its target's
    centre.
    """
    if episode.outcome is None or results.context.judged_by_goal:
        return episode.outcome is not None and episode.outcome.success
    height = episode.record.max_height_m if episode.record else None
    return episode.outcome.is_within(threshold, results.context.max_height if height is None else height)


def workspace_coverage(results: CheckResults, points: Sequence[tuple[float, float]]) -> Coverage | None:
    """Return how points (x, y) in `world`, m, cover the box of sampled start positions."""
    box = results.context.sampling
    return compute_coverage(points, box.x, box.y, CELL_M) if box else None


def _attempt_statistics(
    attempts: Sequence[AttemptRecord], thresholds: Sequence[float], max_height: float
) -> dict[str, Any]:
    n, succeeded = len(attempts), sum(attempt.outcome.success for attempt in attempts)
    hits = {f"{t:g}": sum(attempt.outcome.is_within(t, max_height) for attempt in attempts) for t in thresholds}
    causes = Counter(attempt.outcome.cause for attempt in attempts if attempt.outcome.cause)
    return {
        "n": n,
        "n_success": succeeded,
        "success_rate": succeeded / n if n else None,
        "wilson95": wilson_interval_95(succeeded, n),
        "rates": {t: hit / n if n else None for t, hit in hits.items()},
        "rates_wilson95": {t: wilson_interval_95(hit, n) for t, hit in hits.items()},
        "causes": dict(causes.most_common()),
        "recovered": sum(bool(attempt.outcome.recoveries) for attempt in attempts if attempt.outcome.success),
    }


def _value_distribution(values: Sequence[float]) -> dict[str, Any] | None:
    found = summarize_values(values)
    return found and {**found, "histogram": compute_histogram(values)}


def _value_range(values: Sequence[int]) -> dict[str, float] | None:
    return {"min": min(values), "median": float(np.median(values)), "max": max(values)} if values else None


def _workspace_statistics(results: CheckResults) -> dict[str, Any]:
    box = results.context.sampling
    names = dict.fromkeys(
        name for episode in results.episodes for name in (*episode.start_positions, *episode.end_positions)
    )
    objects = {}
    for name in names:
        starts = [episode.start_positions[name] for episode in results.episodes if name in episode.start_positions]
        ends = [episode.end_positions[name] for episode in results.episodes if name in episode.end_positions]
        objects[printable_line(name)] = {
            "start": _position_extent(results, starts),
            "end": _position_extent(results, ends),
        }
    return {"box": {"x": list(box.x), "y": list(box.y), "cell_m": CELL_M} if box else None, "objects": objects}


def _position_extent(results: CheckResults, points: Sequence[tuple[float, float]]) -> dict[str, Any]:
    if not points:
        return {}
    extent: dict[str, Any] = {
        axis: [min(point[k] for point in points), max(point[k] for point in points)] for k, axis in enumerate("xy")
    }
    if grid := workspace_coverage(results, points):
        extent |= {"cells": grid.cell_count, "cells_hit": grid.hit_cell_count, "outside": grid.outside}
    return extent
