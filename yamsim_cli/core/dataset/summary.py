"""A dataset's statistics and checks, from its files alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import DatasetError
from .check import Decoder, Problem, check_episode
from .layout import CONFIG, MANIFEST, episode_directories
from .records import AttemptRecord, EpisodeRecord, Manifest, from_json
from .statistics import spread, wilson95
from .writer import read_attempts

Progress = Callable[[int, int], None]


def summarize(dataset: Path, thresholds: Sequence[float], decode_image: Decoder, progress: Progress) -> dict[str, Any]:
    """Check and count a dataset.

    Args:
        thresholds: in metres, by which stored outcomes are scored.
        decode_image: see `check.Decoder`.
        progress: called with episodes done and in all.

    Returns:
        JSON-ready: episodes, frames, bytes, success_rate and wilson95 per threshold, attempts, dxy_m, dz_m, workspace,
        cameras, versions, problems.

    Raises:
        DatasetError: there is no dataset at all.
    """
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} is not a directory; give the directory that `yamsim record` wrote")
    directories = episode_directories(dataset)
    if not directories and not (dataset / CONFIG).is_file():
        raise DatasetError(
            f"{dataset} holds no episodes (ep_NNNNNN) and no {CONFIG}; give the directory that `yamsim record` wrote"
        )

    records: list[EpisodeRecord] = []
    problems: list[Problem] = []
    size = 0
    for done, (number, directory) in enumerate(directories, start=1):
        record, found, episode_size = check_episode(directory, number, decode_image)
        problems += found
        size += episode_size
        if record:
            records.append(record)
        progress(done, len(directories))
    try:
        attempts = read_attempts(dataset)
    except DatasetError as error:
        problems.append(Problem("", str(error), "the ledger is damaged"))
        attempts = []
    problems += _gaps([number for number, _ in directories], attempts)
    problems += _manifest_problems(dataset, records)

    outcomes = [(record.outcome, record.max_height_m) for record in records]
    hits = {f"{t:g}": sum(outcome.within(t, height) for outcome, height in outcomes) for t in thresholds}
    return {
        "path": str(dataset),
        "episodes": len(directories),
        "frames": sum(record.frames for record in records),
        "bytes": size,
        "success_rate": {t: hit / len(records) if records else None for t, hit in hits.items()},
        "wilson95": {t: wilson95(hit, len(records)) for t, hit in hits.items()},
        "attempts": _attempts(attempts),
        "dxy_m": spread([outcome.dxy_m for outcome, _ in outcomes if outcome.dxy_m is not None]),
        "dz_m": spread([outcome.dz_m for outcome, _ in outcomes if outcome.dz_m is not None]),
        "workspace": _workspace(records),
        "cameras": {name: list(wh) for record in records[:1] for name, wh in record.cameras.items()},
        "tasks": sorted({record.task for record in records}),
        "grasps": sorted({record.grasp for record in records}),
        "versions": sorted({tuple(sorted(record.versions.items())) for record in records}),
        "problems": [asdict(problem) for problem in problems],
    }


def _attempts(attempts: Sequence[AttemptRecord]) -> dict[str, Any]:
    succeeded = sum(attempt.outcome.success for attempt in attempts)
    return {
        "n": len(attempts),
        "n_success": succeeded,
        "success_rate": succeeded / len(attempts) if attempts else None,
        "wilson95": wilson95(succeeded, len(attempts)),
        "causes": dict(Counter(attempt.outcome.cause for attempt in attempts if attempt.outcome.cause)),
    }


def _workspace(records: Sequence[EpisodeRecord]) -> dict[str, dict[str, list[float]]]:
    """Object -> range of its start positions, x and y in `world`, m."""
    ranges: dict[str, dict[str, list[float]]] = {}
    for name in dict.fromkeys(name for record in records for name in record.layout):
        starts = [record.layout[name] for record in records if name in record.layout]
        ranges[name] = {axis: [min(s[k] for s in starts), max(s[k] for s in starts)] for k, axis in enumerate("xy")}
    return ranges


def _gaps(numbers: Sequence[int], attempts: Sequence[AttemptRecord]) -> list[Problem]:
    """Episodes that should be there: numbers run from 0 without a gap, and the ledger's are all published."""
    expected = set(range(max(numbers, default=-1) + 1)) | {a.episode for a in attempts if a.episode is not None}
    return [Problem(f"ep_{number:06d}", "", "missing") for number in sorted(expected - set(numbers))]


def _manifest_problems(dataset: Path, records: Sequence[EpisodeRecord]) -> list[Problem]:
    file = dataset / MANIFEST
    if not file.is_file():
        return [Problem("", MANIFEST, "missing; `yamsim record --resume` writes it again")]
    try:
        manifest = from_json(Manifest, file.read_bytes(), MANIFEST)
    except DatasetError as error:
        return [Problem("", MANIFEST, str(error).removeprefix(f"{MANIFEST}: "))]
    listed, found = {entry.episode for entry in manifest.episodes}, {record.episode for record in records}
    if listed != found:
        return [
            Problem(
                "",
                MANIFEST,
                f"lists {len(listed)} episodes, {len(found)} are readable; `yamsim record --resume` writes it again",
            )
        ]
    return []
