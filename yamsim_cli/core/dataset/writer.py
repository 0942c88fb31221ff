"""The only code that writes a dataset: one process, episode by episode; every step leaves a whole dataset behind."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from ..config.document import dump_yaml, parse_yaml
from ..errors import ConfigError, DatasetError, ResourceError
from ..files import append_line, publish_directory, sha256_bytes, write_file
from .faults import reason
from .integrity import Found, find_episodes, set_aside
from .layout import ATTEMPTS, CONFIG, EPISODE, MANIFEST, STAGING, episode_name
from .opening import OpenMode, claim
from .records import AttemptRecord, EpisodeRecord, Manifest, ManifestEntry, from_json, to_json

# A message stays one line that can be read.
_SHOWN_CHANGES = 5

__all__ = ["DatasetWriter", "OpenMode", "read_attempts"]


class DatasetWriter:
    """Publishes episodes and keeps the ledger of attempts and the manifest; a context manager that lets go at the end.

    Attributes:
        path: the dataset's directory.
        moved_aside: where an earlier dataset went with `OpenMode.OVERWRITE`, if there was one.
        repairs: what was found damaged on resuming, and where it was moved, a sentence each.
        attempts: the ledger so far, in order of attempt.
        entries: what the manifest will say of each episode, by its number.
    """

    def __init__(
        self, path: Path, config: Mapping[str, Any], mode: OpenMode, *, locks_reach_others: bool = True
    ) -> None:
        """Open a dataset for writing; nobody else can until it is closed.

        Args:
            config: everything that decides the data, as plain data.
            locks_reach_others: see `DirectoryLock.take`.

        Raises:
            UsageError: the directory is not empty, or is no directory, and the mode does not say what to do.
            ConfigError: resuming with a configuration that would give other data; the message names the keys.
            DatasetError: resuming something that is no dataset, or whose ledger is damaged.
            ResourceError: the directory cannot be made or written, or another recorder is at it.
        """
        self.path = path
        self.repairs: list[str] = []
        self.attempts: list[AttemptRecord] = []
        self.entries: dict[int, ManifestEntry] = {}
        self.episodes = 0
        self._task = str(config["task"]["name"])
        self._seed = int(config["seed"])
        try:
            held = claim(path, mode, locks_reach_others=locks_reach_others)
            self._lock, self.moved_aside = held.lock, held.moved_aside
            try:
                if held.occupied:
                    self._resume(config)
                else:
                    write_file(path / CONFIG, dump_yaml(config).encode())
            except BaseException:
                self.close()
                raise
        except OSError as error:
            raise ResourceError(f"{path} cannot be written: {reason(error, path)}; choose another --out") from error

    @property
    def missing(self) -> list[AttemptRecord]:
        """Attempts whose episode is in the ledger but not on the disk: it has to be made again."""
        return [
            attempt for attempt in self.attempts if attempt.episode is not None and attempt.episode not in self.entries
        ]

    def publish(self, record: EpisodeRecord, files: Mapping[str, bytes]) -> None:
        """Make one episode visible, all of it at once.

        Raises:
            OSError: nothing of it is visible.
        """
        name = episode_name(record.episode)
        text = to_json(record)
        publish_directory(self.path / name, {**files, EPISODE: text}, self.path / STAGING)
        self.entries[record.episode] = _entry(record, text, sum(map(len, files.values())))

    def log(self, attempt: AttemptRecord) -> None:
        """Add one attempt to the ledger; attempts come in order, an attempt after its episode."""
        append_line(self.path / ATTEMPTS, to_json(attempt).decode().rstrip("\n"))
        self._count(attempt)

    def finish(self) -> Manifest:
        """Write the manifest of what is published, and clean up."""
        entries = [self.entries[number] for number in sorted(self.entries)]
        manifest = Manifest(
            task=self._task,
            seed=self._seed,
            attempts=len(self.attempts),
            frames=sum(entry.frames for entry in entries),
            bytes=sum(entry.bytes for entry in entries),
            episodes=entries,
        )
        write_file(self.path / MANIFEST, to_json(manifest, indent=1))
        shutil.rmtree(self.path / STAGING, ignore_errors=True)
        return manifest

    def close(self) -> None:
        """Let others record into the directory."""
        self._lock.release()

    def __enter__(self) -> DatasetWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _count(self, attempt: AttemptRecord) -> None:
        self.attempts.append(attempt)
        self.episodes += attempt.episode is not None

    def _resume(self, config: Mapping[str, Any]) -> None:
        self._compare(config)
        for attempt in read_attempts(self.path):
            self._count(attempt)
        ledger = self.path / ATTEMPTS
        if ledger.is_file() and not ledger.read_bytes().endswith(b"\n"):
            # Cut off: appending after it would leave the damaged line in the middle, where it counts as damage.
            write_file(ledger, b"".join(map(to_json, self.attempts)))
        of_episode = {attempt.episode: attempt for attempt in self.attempts if attempt.episode is not None}
        for found in find_episodes(self.path):
            self._take_up(found, of_episode.get(found.number))
        for attempt in self.missing:
            place = self.path / episode_name(attempt.episode or 0)
            if place.exists():
                self.repairs.append(f"{place.name} is no directory; moved to {set_aside(place)}, and made again")

    def _compare(self, config: Mapping[str, Any]) -> None:
        file = self.path / CONFIG
        if not file.is_file():
            raise DatasetError(
                f"{self.path} has no {CONFIG}, so it is no dataset that could be resumed; choose another --out"
            )
        changed = _differences(parse_yaml(file.read_bytes(), str(file)).data, config)
        if changed:
            more = f"; and {len(changed) - _SHOWN_CHANGES} more" if len(changed) > _SHOWN_CHANGES else ""
            raise ConfigError(
                f"{self.path} was recorded with another configuration: {'; '.join(changed[:_SHOWN_CHANGES])}{more}; "
                f"run with the same values (--config {self.path / CONFIG} has them), or record into another --out"
            )

    def _take_up(self, found: Found, attempt: AttemptRecord | None) -> None:
        """Count an episode that is whole; move one that is not out of the way, to be made again."""
        record, fault = found.record, found.fault
        if record is None or fault is not None:
            self.repairs.append(
                f"{found.directory.name}: {fault}; moved to {set_aside(found.directory)}, and made again"
            )
            return
        if attempt is None:
            # Published just before a crash, and not yet in the ledger.
            if record.attempt != len(self.attempts):
                raise DatasetError(
                    f"{found.directory} is attempt {record.attempt}, but {ATTEMPTS} ends before it; "
                    "it cannot be resumed"
                )
            self.log(
                AttemptRecord(
                    attempt=record.attempt,
                    seed=record.seed,
                    episode=found.number,
                    outcome=record.outcome,
                    layout=record.layout,
                    randomized=record.randomized,
                )
            )
        self.entries[found.number] = _entry(record, found.text, found.size)


def read_attempts(dataset: Path) -> list[AttemptRecord]:
    """The ledger of a dataset, in order; a cut-off last line, as a power cut can leave, does not count.

    Raises:
        DatasetError: a line in the middle is damaged, or attempts are missing.
    """
    file = dataset / ATTEMPTS
    if not file.is_file():
        return []
    lines = file.read_bytes().split(b"\n")
    attempts: list[AttemptRecord] = []
    for number, line in enumerate(lines, start=1):
        if not line:
            continue
        try:
            attempt = from_json(AttemptRecord, line, f"{file}:{number}")
        except DatasetError:
            if number == len(lines):
                break
            raise
        if attempt.attempt != len(attempts):
            raise DatasetError(f"{file}:{number}: attempt {attempt.attempt} where {len(attempts)} was expected")
        attempts.append(attempt)
    return attempts


def _entry(record: EpisodeRecord, text: bytes, size: int) -> ManifestEntry:
    return ManifestEntry(
        episode=record.episode,
        path=episode_name(record.episode),
        attempt=record.attempt,
        frames=record.frames,
        bytes=size + len(text),
        sha256=sha256_bytes(text),
    )


def _flatten(data: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(data, dict):
        return {
            key: value
            for name, inner in data.items()
            for key, value in _flatten(inner, f"{prefix}.{name}" if prefix else name).items()
        }
    if isinstance(data, list | tuple):
        return {key: value for k, inner in enumerate(data) for key, value in _flatten(inner, f"{prefix}[{k}]").items()}
    return {prefix: data}


def _differences(recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """`key: recorded value, wanted value` for every value that differs."""
    old, new = _flatten(recorded), _flatten(wanted)
    return [
        f"{key}: {old.get(key)!r} there, {new.get(key)!r} now"
        for key in dict.fromkeys([*old, *new])
        if old.get(key) != new.get(key)
    ]
