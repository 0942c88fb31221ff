"""Verify episodes on disk by their hashes, and quarantine damaged episodes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ...errors import DatasetError, NewerFormatError
from ...files.writing import sha256_bytes
from ..dataset_paths import EPISODE_FILE, QUARANTINE_FOLDER, episode_directories
from ..records import EpisodeRecord, from_json

_READER_THREADS = 32  # many, since each waits for the disk or network, and hashing releases the GIL


@dataclass(frozen=True)
class InspectedEpisode:
    """Result of reading and hashing all files of an episode directory.

    Attributes:
        record: content of `episode.json`; None if unreadable.
        text: bytes of `episode.json`.
        size: total bytes of the files that the record lists, up to the first fault.
        fault: the first fault; None if the episode is intact.
    """

    number: int
    directory: Path
    record: EpisodeRecord | None
    text: bytes
    size: int
    fault: str | None


def inspect_episodes(dataset: Path) -> list[InspectedEpisode]:
    """Inspect every episode of a dataset, in order. Raise OSError if the disk failed."""
    with ThreadPoolExecutor(_READER_THREADS) as readers:
        return list(readers.map(lambda found: inspect_episode(*found), episode_directories(dataset)))


def quarantine_episode(episode: Path) -> Path:
    """Move a damaged episode into the quarantine directory of its dataset, and return the new path."""
    return episode.rename(quarantine_path(episode))


def quarantine_path(path: Path) -> Path:
    """Return an unused path in the quarantine directory, which is created if missing."""
    folder = path.parent / QUARANTINE_FOLDER
    folder.mkdir(exist_ok=True)
    number = 1
    while (target := folder / f"{path.name}.{number}").exists():
        number += 1
    return target


def inspect_episode(number: int, directory: Path) -> InspectedEpisode:
    """Read and hash all files of one episode. Raise OSError if the disk failed, or NewerFormatError."""

    def inspection_result(record: EpisodeRecord | None, text: bytes, size: int, fault: str | None) -> InspectedEpisode:
        return InspectedEpisode(number, directory, record, text, size, fault)

    try:
        text = (directory / EPISODE_FILE).read_bytes()
    except FileNotFoundError:
        return inspection_result(None, b"", 0, f"{EPISODE_FILE} is missing")
    try:
        record = from_json(EpisodeRecord, text, EPISODE_FILE)
    except NewerFormatError:
        raise  # the episode is not damaged, and must not be quarantined
    except DatasetError as error:
        return inspection_result(None, text, 0, str(error))
    if record.episode != number:
        return inspection_result(record, text, 0, f"{EPISODE_FILE} is of episode {record.episode}")
    size = 0
    for name, sha256 in record.files.items():
        try:
            data = (directory / name).read_bytes()
        except FileNotFoundError:
            return inspection_result(record, text, size, f"{name} is missing")
        size += len(data)
        if sha256_bytes(data) != sha256:
            return inspection_result(
                record, text, size, f"{name} is not what was recorded ({len(data)} bytes, another hash)"
            )
    return inspection_result(record, text, size, None)
