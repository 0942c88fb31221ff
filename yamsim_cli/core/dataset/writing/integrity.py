"""Checks by hashes that episodes on the disk are what was written, and moves away those that are not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ...errors import DatasetError
from ...files import sha256_bytes
from ..layout import DAMAGED, EPISODE, episode_directories
from ..records import EpisodeRecord, from_json

# Threads that read: each waits for the disk or the network, and hashing leaves the interpreter free.
_READERS = 32


@dataclass(frozen=True)
class Found:
    """An episode's directory as it was found.

    Attributes:
        record: its `episode.json`; None if that cannot be read.
        text: the bytes of its `episode.json`.
        size: bytes of all files that the record names.
        fault: what is wrong with it; None if it is whole.
    """

    number: int
    directory: Path
    record: EpisodeRecord | None
    text: bytes
    size: int
    fault: str | None


def find_episodes(dataset: Path) -> list[Found]:
    """Every episode in a dataset, in order, with all its files read and hashed.

    Raises:
        OSError: the disk failed; that a file is missing or altered is a fault of the episode and no error.
    """
    with ThreadPoolExecutor(_READERS) as readers:
        return list(readers.map(lambda found: inspect_episode(*found), episode_directories(dataset)))


def set_aside(episode: Path) -> Path:
    """The new place of a damaged episode, which is moved into its dataset's directory for damaged parts."""
    return episode.rename(place_for_damaged(episode))


def place_for_damaged(path: Path) -> Path:
    """A free path for a damaged part of a dataset, in the directory for damaged parts, which is made if missing."""
    folder = path.parent / DAMAGED
    folder.mkdir(exist_ok=True)
    number = 1
    while (target := folder / f"{path.name}.{number}").exists():
        number += 1
    return target


def inspect_episode(number: int, directory: Path) -> Found:
    """One episode, all its files read and hashed; see `find_episodes`."""

    def found(record: EpisodeRecord | None, text: bytes, size: int, fault: str | None) -> Found:
        return Found(number, directory, record, text, size, fault)

    try:
        text = (directory / EPISODE).read_bytes()
    except FileNotFoundError:
        return found(None, b"", 0, f"{EPISODE} is missing")
    try:
        record = from_json(EpisodeRecord, text, EPISODE)
    except DatasetError as error:
        return found(None, text, 0, str(error))
    if record.episode != number:
        return found(record, text, 0, f"{EPISODE} is that of episode {record.episode}")
    size = 0
    for name, sha256 in record.files.items():
        try:
            data = (directory / name).read_bytes()
        except FileNotFoundError:
            return found(record, text, size, f"{name} is missing")
        size += len(data)
        if sha256_bytes(data) != sha256:
            return found(record, text, size, f"{name} is not what was recorded ({len(data)} bytes, another hash)")
    return found(record, text, size, None)
