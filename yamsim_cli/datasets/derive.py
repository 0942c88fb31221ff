"""Write datasets from datasets: merge several, split one, or filter one by decisions.

The result is a dataset of whole copied episodes, with new numbers. `provenance.json` lists the source of each episode,
with its hash. It replaces the ledger of attempts, because the result has only some attempts of its sources. The result
is built in `<out>.part` and renamed when it is complete. A repeated call continues there, and keeps intact episodes.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.dataset.dataset_paths import (
    CONFIG_FILE,
    EPISODE_FILE,
    MANIFEST_FILE,
    PROVENANCE_FILE,
    STAGING_FOLDER,
    episode_name,
)
from ..core.dataset.disk_errors import explain_disk_error
from ..core.dataset.imported_records import is_imported_dataset
from ..core.dataset.reader import RecordedEpisode, open_recorded_episode, select_episode_directories
from ..core.dataset.records import EpisodeRecord, Manifest, ManifestEntry, to_json
from ..core.dataset.upgrade import upgrade_config
from ..core.dataset.writing.directory_claim import DirectoryLock
from ..core.errors import ConfigError, DatasetError, InterruptedJobError, PartialJobError, UsageError
from ..core.files.documents.yaml_document import load_yaml
from ..core.files.writing import fsync_directory, publish_directory, sha256_bytes, sha256_file, write_file
from ..core.progress import Progress
from ..selection import SELECTION_FILE, EpisodeDecision, Selection, apply_selection, write_selection

PROVENANCE_FORMAT = "yamsim-provenance"  # value of `format` in provenance.json
PROVENANCE_VERSION = 1  # value of `format_version`
_FREE_KEYS = ("seed", "episodes", "workers", "n")  # config keys that may differ between merged datasets
_START_DIGITS = 6  # decimals of m and of quaternions; independent starts never agree so closely


@dataclass(frozen=True)
class SourceEpisode:
    """An episode to copy: the index of its dataset among the sources, and the decision of a person on it."""

    source: int
    episode: RecordedEpisode
    sha256: str
    decision: EpisodeDecision | None


@dataclass(frozen=True)
class SourceDataset:
    """A dataset to copy from, and the selection that chose its episodes."""

    path: Path
    episodes: tuple[SourceEpisode, ...]
    selection: Mapping[str, Any] | None

    def provenance(self) -> dict[str, Any]:
        """Return the entry of the dataset in `provenance.json`."""
        derived = self.path / PROVENANCE_FILE
        return {
            "dataset": self.path.absolute().name,
            "config_sha256": sha256_file(self.path / CONFIG_FILE),
            "provenance_sha256": sha256_file(derived) if derived.is_file() else None,
            "selection": self.selection and {key: self.selection[key] for key in self.selection if key != "file"},
        }


@dataclass(frozen=True)
class DerivedDataset:
    """A written dataset.

    Attributes:
        kept: number of episodes that an interrupted earlier call had already copied.
        duplicates: number of episodes that were left out because an earlier one has the same values.
    """

    path: Path
    episodes: int
    frames: int
    kept: int
    duplicates: int = 0

    def report(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        return {"path": str(self.path), "episodes": self.episodes, "frames": self.frames, "kept": self.kept} | {
            "duplicates": self.duplicates
        }


def open_source_dataset(
    index: int, path: Path, selection: Path | None = None, episodes: str | None = None
) -> SourceDataset:
    """Open the episodes of a dataset that a selection keeps, and that `episodes` (such as `0,3,5-9`) lists."""
    applied = apply_selection(path, selection) if selection else None
    decisions = applied.decisions if applied else {}
    found = []
    for number, directory in select_episode_directories(path, episodes, None, applied.kept if applied else None):
        episode = open_recorded_episode(directory)
        if episode.record.episode != number:
            raise DatasetError(f"{directory / EPISODE_FILE} is of episode {episode.record.episode}")
        sha256 = sha256_file(directory / EPISODE_FILE)
        found.append(SourceEpisode(index, episode, sha256, decisions.get(number)))
    return SourceDataset(path, tuple(found), applied.report() if applied else None)


def merge_datasets(sources: Sequence[SourceDataset], out: Path, progress: Progress) -> DerivedDataset:
    """Write the episodes of several datasets, in order, without those that equal an earlier one in all values.

    Raises:
        ConfigError: the datasets were recorded with different configurations.
        DatasetError: an episode differs from its hashes.
        UsageError: `out` exists, or no episode is left.
    """
    for other in sources[1:]:
        _require_same_config(sources[0].path, other.path)
    chosen: dict[str, SourceEpisode] = {}
    for item in (item for source in sources for item in source.episodes):
        chosen.setdefault(item.episode.record.content_sha256, item)
    total = sum(len(source.episodes) for source in sources)
    return _write(sources, list(chosen.values()), out, progress, {"command": "merge"}, total - len(chosen))


def filter_dataset(source: SourceDataset, out: Path, progress: Progress) -> DerivedDataset:
    """Write the chosen episodes of a dataset. Raises as `merge_datasets`."""
    return _write([source], list(source.episodes), out, progress, {"command": "filter"})


def split_dataset(
    source: SourceDataset, out: Path, shares: Mapping[str, float], seed: int, progress: Progress
) -> dict[str, DerivedDataset]:
    """Write a dataset as several parts, which are datasets in the folder `out`.

    Episodes of the same seed and attempt, of the same start, or with the same values are never in different parts. The
    parts depend only on the episodes, `shares` and `seed`.

    Args:
        shares: name of the part -> share of the episodes; the sum is 1.
    """
    parts = assign_parts(source.episodes, shares, seed)
    for name, items in parts.items():
        if not items:
            raise UsageError(
                f"--part {name}={shares[name]:g}: no episode is left for it, because only "
                f"{len(group_by_start(source.episodes))} groups of episodes have different starts; give larger shares"
            )
    out.mkdir(parents=True, exist_ok=True)
    done: dict[str, DerivedDataset] = {}
    for name, items in parts.items():
        settings = {"command": "split", "part": name, "seed": seed, "shares": dict(shares)}
        offset = sum(part.episodes for part in done.values())

        def advance(count: int, _: int, offset: int = offset) -> None:
            progress(offset + count, len(source.episodes))

        done[name] = _write([source], items, out / name, advance, settings)
    return done


def group_by_start(episodes: Sequence[SourceEpisode]) -> list[list[SourceEpisode]]:
    """Return groups of episodes that share a seed and attempt, a start, or all values; in order of the first one."""
    group_of = list(range(len(episodes)))

    def root(k: int) -> int:
        while group_of[k] != k:
            k = group_of[k]
        return k

    first: dict[tuple[Any, ...], int] = {}
    for k, item in enumerate(episodes):
        for key in _start_keys(item.episode):
            low, high = sorted((root(k), root(first.setdefault(key, k))))
            group_of[high] = low
    groups: dict[int, list[SourceEpisode]] = {}
    for k, item in enumerate(episodes):
        groups.setdefault(root(k), []).append(item)
    return list(groups.values())


def _start_keys(episode: RecordedEpisode) -> list[tuple[Any, ...]]:
    record = episode.record
    keys: list[tuple[Any, ...]] = [("values", record.content_sha256)]
    if isinstance(record, EpisodeRecord):
        keys.append(("seed", record.seed, record.attempt))
        if record.layout:
            places = ((name, tuple(round(v, _START_DIGITS) for v in place)) for name, place in record.layout.items())
            keys.append(("start", *sorted(places)))
    return keys


def assign_parts(
    episodes: Sequence[SourceEpisode], shares: Mapping[str, float], seed: int
) -> dict[str, list[SourceEpisode]]:
    """Return part -> episodes in order. Groups of `group_by_start` stay together; `seed` shuffles them."""
    groups = group_by_start(episodes)
    parts: dict[str, list[SourceEpisode]] = {name: [] for name in shares}
    for k in np.random.default_rng(seed).permutation(len(groups)):
        missing = {name: share * len(episodes) - len(parts[name]) for name, share in shares.items()}
        parts[max(missing, key=lambda name: missing[name])] += groups[k]
    return {name: sorted(items, key=lambda item: item.episode.record.episode) for name, items in parts.items()}


def _require_same_config(first: Path, other: Path) -> None:
    one, two = (upgrade_config(load_yaml(path / CONFIG_FILE).data) for path in (first, other))
    keys = [key for key in dict.fromkeys([*one, *two]) if key not in _FREE_KEYS and one.get(key) != two.get(key)]
    if keys:
        raise ConfigError(
            f"{other / CONFIG_FILE}: {', '.join(keys)} differ from {first / CONFIG_FILE}; merge only datasets that "
            "differ in nothing but their seed"
        )


@dataclass
class _Part:
    """The hidden dataset in progress."""

    path: Path
    entries: list[ManifestEntry] = field(default_factory=list)
    decisions: dict[int, EpisodeDecision] = field(default_factory=dict)
    kept: int = 0


def _write(
    sources: Sequence[SourceDataset],
    items: Sequence[SourceEpisode],
    out: Path,
    progress: Progress,
    settings: Mapping[str, Any],
    duplicates: int = 0,
) -> DerivedDataset:
    if not items:
        raise UsageError(f"{out}: no episode is left to write; choose more")
    provenance = _provenance_text(sources, items, settings)
    frames = sum(item.episode.record.frames for item in items)
    if _is_done(out, provenance):
        progress(len(items), len(items))
        return DerivedDataset(out, len(items), frames, len(items), duplicates)
    part = _Part(out.with_name(f"{out.name}.part"))
    try:
        part.path.mkdir(parents=True, exist_ok=True)
        lock = DirectoryLock.acquire(part.path)
        try:
            _begin(part.path, sources[0].path, provenance)
            for number, item in enumerate(items):
                _copy_episode(part, number, item)
                progress(number + 1, len(items))
            _finish(part, sources[0].path, items)
        finally:
            lock.release()
        if out.is_dir():
            out.rmdir()
        part.path.rename(out)
        fsync_directory(out.absolute().parent)
    except OSError as error:
        raise PartialJobError(f"{explain_disk_error(error, part.path)}: {out} was not written") from error
    except KeyboardInterrupt:
        raise InterruptedJobError(f"interrupted: {out} was not written; the same command continues it") from None
    return DerivedDataset(out, len(items), frames, part.kept, duplicates)


def _is_done(out: Path, provenance: bytes) -> bool:
    """Return whether `out` is the result of the same call. Raise UsageError if it is something else."""
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return False
    if (out / PROVENANCE_FILE).is_file() and (out / PROVENANCE_FILE).read_bytes() == provenance:
        return True
    raise UsageError(f"{out} exists, and was not made from these episodes; choose another --out")


def _begin(part: Path, first: Path, provenance: bytes) -> None:
    file = part / PROVENANCE_FILE
    if file.is_file() and file.read_bytes() != provenance:
        raise UsageError(f"{part} is the unfinished result of another command; delete it, or choose another --out")
    shutil.rmtree(part / STAGING_FOLDER, ignore_errors=True)
    write_file(part / CONFIG_FILE, (first / CONFIG_FILE).read_bytes())
    write_file(file, provenance)


def _provenance_text(
    sources: Sequence[SourceDataset], items: Sequence[SourceEpisode], settings: Mapping[str, Any]
) -> bytes:
    content = {"format": PROVENANCE_FORMAT, "format_version": PROVENANCE_VERSION, **settings}
    content["sources"] = [source.provenance() for source in sources]
    content["episodes"] = [
        {
            "episode": number,
            "source": item.source,
            "source_episode": item.episode.record.episode,
            "source_sha256": item.sha256,
        }
        for number, item in enumerate(items)
    ]
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def _copy_episode(part: _Part, number: int, item: SourceEpisode) -> None:
    episode, directory = item.episode, part.path / episode_name(number)
    text = _renumbered_record(episode, number, item.sha256)
    size = 0
    if _is_intact(directory, text, episode):
        part.kept += 1
        size = sum((directory / name).stat().st_size for name in episode.record.files)
    else:
        shutil.rmtree(directory, ignore_errors=True)
        files = {name: episode.read_verified(name) for name in episode.record.files}
        publish_directory(directory, {**files, EPISODE_FILE: text}, part.path / STAGING_FOLDER)
        size = sum(map(len, files.values()))
    record, sha256 = episode.record, sha256_bytes(text)
    part.entries.append(
        ManifestEntry(
            episode=number,
            path=directory.name,
            attempt=record.attempt if isinstance(record, EpisodeRecord) else number,
            frames=record.frames,
            bytes=size + len(text),
            sha256=sha256,
        )
    )
    if item.decision is not None:
        part.decisions[number] = item.decision.model_copy(update={"episode": number, "sha256": sha256})


def _renumbered_record(episode: RecordedEpisode, number: int, sha256: str) -> bytes:
    """Return `episode.json` with another episode number, and otherwise the same values."""
    text = episode.read(EPISODE_FILE)
    if sha256_bytes(text) != sha256:
        raise DatasetError(f"{episode.directory / EPISODE_FILE} has changed since this command began; run it again")
    if episode.record.episode == number:
        return text
    return (json.dumps(json.loads(text) | {"episode": number}, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _is_intact(directory: Path, text: bytes, episode: RecordedEpisode) -> bool:
    try:
        if (directory / EPISODE_FILE).read_bytes() != text:
            return False
        return all(sha256_file(directory / name) == sha256 for name, sha256 in episode.record.files.items())
    except FileNotFoundError:
        return False


def _finish(part: _Part, first: Path, items: Sequence[SourceEpisode]) -> None:
    shutil.rmtree(part.path / STAGING_FOLDER, ignore_errors=True)
    if part.decisions:
        # Trims, tags and notes stay with the copied episodes, which are whole.
        write_selection(part.path / SELECTION_FILE, Selection(part.path.stem, "keep", part.decisions))
    if is_imported_dataset(first):
        return
    record = items[0].episode.record
    assert isinstance(record, EpisodeRecord), "only imported datasets have other records"
    manifest = Manifest(
        task=record.task,
        seed=record.seed,
        attempts=len(items),
        frames=sum(entry.frames for entry in part.entries),
        bytes=sum(entry.bytes for entry in part.entries),
        episodes=part.entries,
    )
    write_file(part.path / MANIFEST_FILE, to_json(manifest, indent=1))
