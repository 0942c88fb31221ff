"""Checks that the ledger of attempts and the manifest can be read, and agree with the episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...errors import DatasetError
from ..layout import ATTEMPTS, EPISODE, MANIFEST
from ..records import AttemptRecord, Manifest, from_json
from .facts import EpisodeFacts
from .problem import Problem, Problems

_LARGEST_MANIFEST = 2**30


def read_ledger(dataset: Path, problems: Problems) -> list[AttemptRecord]:
    """Every attempt that can be read, in order. Damaged lines and missing attempts are noted."""
    file = dataset / ATTEMPTS
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
                    problems.add("ledger.cut" if cut else "ledger.damaged", ATTEMPTS, str(error))
                    expected += 1
                    continue
                if attempt.attempt != expected:
                    problems.add("ledger.gap", ATTEMPTS, f"line {number} is attempt {attempt.attempt}", expected)
                expected = attempt.attempt + 1
                attempts.append(attempt)
    except OSError as error:
        problems.add("ledger.damaged", ATTEMPTS, error.strerror)
    return attempts


def compare_ledger(
    dataset: Path, attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeFacts], problems: Problems
) -> list[Problem]:
    """Faults of episodes that differ from the ledger. Faults of the ledger itself are added to `problems`."""
    recorded = [episode for episode in episodes if episode.record]
    if not (dataset / ATTEMPTS).is_file():
        if recorded:
            problems.add("ledger.missing", ATTEMPTS)
        return []
    logged = {attempt.episode: attempt for attempt in attempts}
    unlogged = [episode.name for episode in recorded if episode.number not in logged]
    # Episodes whose line is damaged or missing have been noted as such.
    if unlogged and not problems.have("ledger."):
        problems.add("ledger.unlogged", ATTEMPTS, ", ".join(unlogged))
    found = []
    for episode in recorded:
        own = Problems(episode.name)
        if (attempt := logged.get(episode.number)) and (differing := _differing(attempt, episode)):
            own.add("ledger.differs", EPISODE, differing[0], differing[1])
        found += own.list()
    return found


def _differing(attempt: AttemptRecord, episode: EpisodeFacts) -> tuple[str, str] | None:
    """The first value that differs: in the episode, and in the ledger; None if all agree."""
    record = episode.record
    assert record is not None
    for key in ("attempt", "seed", "outcome", "layout"):
        ours, theirs = getattr(record, key), getattr(attempt, key)
        if ours != theirs:
            return f"{key} {_shown(ours, theirs)}", f"{_shown(theirs, ours)}, as in {ATTEMPTS}"
    return None


def _shown(value: object, other: object) -> str:
    """Text of a value; of a record only the entries that differ from the other's."""
    if hasattr(value, "model_dump") and hasattr(other, "model_dump"):
        mine, theirs = value.model_dump(), other.model_dump()
        return ", ".join(f"{key} {mine[key]}" for key in mine if mine[key] != theirs.get(key))
    return str(value)


def check_manifest(
    dataset: Path, episodes: Mapping[int, EpisodeFacts], problems: Problems
) -> tuple[set[int], list[Problem]]:
    """Numbers of the episodes that the manifest lists, and faults of those that differ from it."""
    file = dataset / MANIFEST
    if not file.is_file():
        problems.add("manifest.missing", MANIFEST)
        return set(), []
    try:
        if file.stat().st_size > _LARGEST_MANIFEST:
            raise DatasetError(f"{file.stat().st_size} bytes")
        manifest = from_json(Manifest, file.read_bytes(), MANIFEST)
    except (DatasetError, OSError) as error:
        text = error.strerror if isinstance(error, OSError) else str(error).removeprefix(f"{MANIFEST}: ")
        problems.add("manifest.damaged", MANIFEST, text)
        return set(), []

    found = []
    for entry in manifest.episodes:
        episode = episodes.get(entry.episode)
        if episode is None or not episode.record:
            continue
        own = Problems(episode.name)
        for key, value, listed in (
            ("path", episode.name, entry.path),
            ("attempt", episode.record.attempt, entry.attempt),
            ("frames", episode.record.frames, entry.frames),
            ("sha256", episode.record_sha256, entry.sha256),
        ):
            if value != listed:
                own.add("manifest.differs", EPISODE, f"{key} {value}", f"{listed}, as in {MANIFEST}")
                break
        found += own.list()
    listed_numbers = {entry.episode for entry in manifest.episodes}
    if unlisted := [episode.name for number, episode in sorted(episodes.items()) if number not in listed_numbers]:
        problems.add("manifest.stale", MANIFEST, f"{len(unlisted)}, first {unlisted[0]}")
    totals = sum(entry.frames for entry in manifest.episodes), sum(entry.bytes for entry in manifest.episodes)
    if totals != (manifest.frames, manifest.bytes):
        value = f"{manifest.frames} frames and {manifest.bytes} bytes in all"
        problems.add("manifest.differs", MANIFEST, value, f"{totals[0]} and {totals[1]}, the sum of its entries")
    return listed_numbers, found
