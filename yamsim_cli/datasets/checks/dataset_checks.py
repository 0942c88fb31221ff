"""Check a dataset as a whole: ledger, manifest, and missing, duplicate and dissimilar episodes."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from yamsim_cli.core.config.mesh_provenance import describe_mesh_content
from yamsim_cli.core.dataset.checks.context import CheckContext, looks_like_episode
from yamsim_cli.core.dataset.checks.problem import DatasetProblem, ProblemCollector
from yamsim_cli.core.dataset.dataset_paths import (
    EPISODE_FILE,
    LEDGER_FILE,
    MANIFEST_FILE,
    PROVENANCE_FILE,
    RECORDINGS_FOLDER,
    STAGING_FOLDER,
    episode_name,
)
from yamsim_cli.core.dataset.records import AttemptRecord, Manifest, from_json
from yamsim_cli.core.errors import DatasetError

from .episode_facts import EpisodeFacts

_LAYOUT_DECIMALS = 6  # decimals of m and rad; independent samples never agree so closely
_MAX_MANIFEST_BYTES = 2**30  # bytes, largest manifest that is read
_PART_FILE_NAME = re.compile(r"\..+\.part")  # temporary file that a crash left


def check_dataset(
    dataset: Path,
    context: CheckContext,
    episodes: Sequence[EpisodeFacts],
    attempts: Sequence[AttemptRecord],
    problems: ProblemCollector,
) -> list[DatasetProblem]:
    """Return faults of episodes that differ from each other, the ledger or the manifest. Add other faults to
    `problems`.
    """
    found: list[DatasetProblem] = []
    if not episodes:
        problems.add("dataset.empty")
    if context.recorded:
        numbers = {episode.number: episode for episode in episodes if episode.number is not None}
        found += compare_ledger(dataset, attempts, episodes, problems)
        listed, differing = check_manifest(dataset, numbers, problems) if episodes or attempts else (set(), [])
        logged = {attempt.episode for attempt in attempts if attempt.episode is not None}
        found += differing + _find_missing_episodes(set(numbers), listed | logged)
        _report_interrupted_writes(dataset, {episode.name for episode in episodes}, problems)
    else:
        if not context.real:
            problems.add("dataset.plain")
        _report_missing_numbers([episode.name for episode in episodes], problems)
    found += _find_duplicate_episodes(episodes)
    _report_mixed_settings(episodes, problems)
    return found


def _find_missing_episodes(present: set[int], listed: set[int]) -> list[DatasetProblem]:
    """Return a fault for each gap: numbers start at 0, and listed episodes existed."""
    known = sorted(present | listed)
    runs = [(low + 1, high - 1) for low, high in itertools.pairwise([-1, *known]) if high - low > 1]
    runs += [(number, number) for number in listed - present]
    joined: list[tuple[int, int]] = []
    for low, high in sorted(runs):
        if joined and joined[-1][1] + 1 == low:
            joined[-1] = (joined[-1][0], high)
        else:
            joined.append((low, high))
    found = []
    for low, high in joined:
        own = ProblemCollector(episode_name(low))
        own.add("episode.missing", "", f"to {episode_name(high)}, {high - low + 1} episodes" if high > low else "")
        found += own.all_problems()
    return found


def _report_missing_numbers(names: Sequence[str], problems: ProblemCollector) -> None:
    """Report gaps if all directory names consist of the same word and a number."""
    matches = [re.fullmatch(r"(.*?)([0-9]{1,18})", name) for name in names]
    parts = [(match[1], int(match[2])) for match in matches if match]
    if len(parts) < len(names) or len({word for word, _ in parts}) != 1:
        return
    numbers = sorted(number for _, number in parts)
    gaps = [(low + 1, high - 1) for low, high in itertools.pairwise(numbers) if high - low > 1]
    if gaps:
        shown = ", ".join(f"{low}" if low == high else f"{low} to {high}" for low, high in gaps)
        problems.add("episode.gap", "", shown)


def _find_duplicate_episodes(episodes: Sequence[EpisodeFacts]) -> list[DatasetProblem]:
    """Return faults of episodes that equal an earlier one in all values or in the layout."""
    contents: dict[str, str] = {}
    layouts: dict[tuple[tuple[str, tuple[float, ...]], ...], str] = {}
    found = []
    for episode in episodes:
        own = ProblemCollector(episode.name)
        places = tuple(
            sorted((name, tuple(round(v, _LAYOUT_DECIMALS) for v in place)) for name, place in episode.layout.items())
        )
        if episode.content and episode.content in contents:
            own.add("episode.duplicate", "", f"every value equals that of {contents[episode.content]}")
        elif places and places in layouts:
            own.add("episode.layout", "", f"all objects have the poses of {layouts[places]}")
        contents.setdefault(episode.content, episode.name)
        layouts.setdefault(places, episode.name)
        found += own.all_problems()
    return found


def _report_mixed_settings(episodes: Sequence[EpisodeFacts], problems: ProblemCollector) -> None:
    cameras = (", ".join(f"{name} {w}x{h}" for name, (w, h) in sorted(e.cameras.items())) for e in episodes)
    _report_differing_settings("cameras", (text for text in cameras if text), problems)
    records = [episode.record for episode in episodes if episode.record]
    for key in ("source", "rig", "scene", "task", "grasp", "frame_period_s", "renderer"):
        _report_differing_settings(key, (str(getattr(record, key)) for record in records), problems)
    drawn = [record.meshes for record in records]
    for name in sorted({name for meshes in drawn if meshes for name in meshes}):
        _report_differing_settings(
            f"meshes {name}",
            ("not recorded" if m is None else describe_mesh_content(m.get(name)) for m in drawn),
            problems,
        )
    for package in sorted({package for record in records for package in record.versions}):
        _report_differing_settings(package, (record.versions.get(package, "none") for record in records), problems)


def _report_differing_settings(what: str, values: Iterable[str], problems: ProblemCollector) -> None:
    counts = Counter(values)
    if len(counts) > 1:
        problems.add("dataset.mixed", "", f"{what}: " + "; ".join(f"{n} x {text}" for text, n in counts.most_common()))


def _report_interrupted_writes(dataset: Path, known: set[str], problems: ProblemCollector) -> None:
    for path in sorted(dataset.iterdir()):
        if path.name in (STAGING_FOLDER, RECORDINGS_FOLDER):
            for staged in sorted(path.glob("*")):
                problems.add("leftover.staging", f"{path.name}/{staged.name}")
        elif _PART_FILE_NAME.fullmatch(path.name):
            problems.add("leftover.staging", path.name)
        elif path.name not in known and looks_like_episode(path):
            problems.add("leftover.directory", path.name)


def read_ledger(dataset: Path, problems: ProblemCollector) -> list[AttemptRecord]:
    """Return all readable attempts, in order. Add damaged lines and missing attempts to `problems`."""
    file = dataset / LEDGER_FILE
    attempts: list[AttemptRecord] = []
    if not file.is_file():
        return attempts
    expected = 0
    try:
        with file.open("rb") as lines:
            for number, line in enumerate(lines, start=1):
                if not line.strip():
                    continue
                try:
                    attempt = from_json(AttemptRecord, line, f"line {number}")
                except DatasetError as error:
                    cut = not line.endswith(b"\n")
                    problems.add("ledger.cut" if cut else "ledger.damaged", LEDGER_FILE, str(error))
                    expected += 1
                    continue
                if attempt.attempt != expected:
                    problems.add("ledger.gap", LEDGER_FILE, f"line {number} is attempt {attempt.attempt}", expected)
                expected = attempt.attempt + 1
                attempts.append(attempt)
    except OSError as error:
        problems.add("ledger.damaged", LEDGER_FILE, error.strerror)
    return attempts


def compare_ledger(
    dataset: Path, attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeFacts], problems: ProblemCollector
) -> list[DatasetProblem]:
    """Return faults of episodes that differ from the ledger. Add faults of the ledger itself to `problems`."""
    recorded = [episode for episode in episodes if episode.record]
    if (dataset / PROVENANCE_FILE).is_file():
        return []  # a dataset made from others has only some attempts of its sources, and no ledger
    if not (dataset / LEDGER_FILE).is_file():
        if recorded:
            problems.add("ledger.missing", LEDGER_FILE)
        return []
    logged = {attempt.episode: attempt for attempt in attempts}
    unlogged = [episode.name for episode in recorded if episode.number not in logged]
    if unlogged and not any(problem.code.startswith("ledger.") for problem in problems.all_problems()):
        problems.add("ledger.unlogged", LEDGER_FILE, ", ".join(unlogged))
    found = []
    for episode in recorded:
        own = ProblemCollector(episode.name)
        if (attempt := logged.get(episode.number)) and (differing := _find_difference(attempt, episode)):
            own.add("ledger.differs", EPISODE_FILE, differing[0], differing[1])
        found += own.all_problems()
    return found


def _find_difference(attempt: AttemptRecord, episode: EpisodeFacts) -> tuple[str, str] | None:
    record = episode.record
    assert record is not None
    for key in ("attempt", "seed", "outcome", "layout"):
        ours, theirs = getattr(record, key), getattr(attempt, key)
        if ours != theirs:
            return (
                f"{key} {_differing_entries_text(ours, theirs)}",
                f"{_differing_entries_text(theirs, ours)}, as in {LEDGER_FILE}",
            )
    return None


def _differing_entries_text(value: object, other: object) -> str:
    if hasattr(value, "model_dump") and hasattr(other, "model_dump"):
        mine, theirs = value.model_dump(), other.model_dump()
        return ", ".join(f"{key} {mine[key]}" for key in mine if mine[key] != theirs.get(key))
    return str(value)


def check_manifest(
    dataset: Path, episodes: Mapping[int, EpisodeFacts], problems: ProblemCollector
) -> tuple[set[int], list[DatasetProblem]]:
    """Return the numbers of the episodes in the manifest, and faults of episodes that differ from it."""
    file = dataset / MANIFEST_FILE
    if not file.is_file():
        problems.add("manifest.missing", MANIFEST_FILE)
        return set(), []
    try:
        if file.stat().st_size > _MAX_MANIFEST_BYTES:
            raise DatasetError(f"{file.stat().st_size} bytes")
        manifest = from_json(Manifest, file.read_bytes(), MANIFEST_FILE)
    except (DatasetError, OSError) as error:
        text = error.strerror if isinstance(error, OSError) else str(error).removeprefix(f"{MANIFEST_FILE}: ")
        problems.add("manifest.damaged", MANIFEST_FILE, text)
        return set(), []

    found = []
    for entry in manifest.episodes:
        episode = episodes.get(entry.episode)
        if episode is None or not episode.record:
            continue
        own = ProblemCollector(episode.name)
        for key, value, listed in (
            ("path", episode.name, entry.path),
            ("attempt", episode.record.attempt, entry.attempt),
            ("frames", episode.record.frames, entry.frames),
            ("sha256", episode.record_sha256, entry.sha256),
        ):
            if value != listed:
                own.add("manifest.differs", EPISODE_FILE, f"{key} {value}", f"{listed}, as in {MANIFEST_FILE}")
                break
        found += own.all_problems()
    listed_numbers = {entry.episode for entry in manifest.episodes}
    if unlisted := [episode.name for number, episode in sorted(episodes.items()) if number not in listed_numbers]:
        problems.add("manifest.stale", MANIFEST_FILE, f"{len(unlisted)}, first {unlisted[0]}")
    totals = sum(entry.frames for entry in manifest.episodes), sum(entry.bytes for entry in manifest.episodes)
    if totals != (manifest.frames, manifest.bytes):
        value = f"{manifest.frames} frames and {manifest.bytes} bytes in all"
        problems.add("manifest.differs", MANIFEST_FILE, value, f"{totals[0]} and {totals[1]}, the sum of its entries")
    return listed_numbers, found
