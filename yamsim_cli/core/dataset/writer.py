"""The only code that writes a dataset: one process, episode by episode; every step leaves a whole dataset behind."""

from __future__ import annotations

import shutil
from enum import Enum
from pathlib import Path
from typing import Any

from ..config.document import dump_yaml, parse_yaml
from ..errors import ConfigError, DatasetError, ResourceError, UsageError
from ..files import append_line, move_aside, publish_directory, sha256_bytes, write_file
from .layout import ATTEMPTS, CONFIG, EPISODE, MANIFEST, STAGING, episode_directories, episode_name
from .records import AttemptRecord, EpisodeRecord, Manifest, ManifestEntry, from_json, to_json

# A message stays one line that can be read.
_SHOWN_CHANGES = 5


class OpenMode(Enum):
    """What to do when the dataset's directory already holds something."""

    NEW = "new"
    RESUME = "resume"
    OVERWRITE = "overwrite"


class DatasetWriter:
    """Publishes episodes and keeps the ledger of attempts and the manifest.

    Attributes:
        path: the dataset's directory.
        moved_aside: where an earlier dataset went with `OpenMode.OVERWRITE`, if there was one.
        attempts: the ledger so far, in order of attempt.
    """

    def __init__(self, path: Path, config: dict[str, Any], mode: OpenMode) -> None:
        """Open a dataset for writing.

        Args:
            config: everything that decides the data, as plain data.

        Raises:
            UsageError: the directory is not empty, or is no directory, and the mode does not say what to do.
            ConfigError: resuming with a configuration that would give other data; the message names the keys.
            DatasetError: resuming something that is no dataset, or is damaged.
            ResourceError: the directory cannot be made or written.
        """
        self.path = path
        self.moved_aside: Path | None = None
        self.attempts: list[AttemptRecord] = []
        self._entries: dict[int, ManifestEntry] = {}
        self._task = str(config["task"]["name"])
        self._seed = int(config["seed"])
        try:
            occupied = path.exists() and (not path.is_dir() or any(path.iterdir()))
            if occupied and mode is OpenMode.OVERWRITE:
                self.moved_aside = move_aside(path)
                occupied = False
            if occupied and mode is OpenMode.NEW:
                what = "is not empty" if path.is_dir() else "is not a directory"
                raise UsageError(
                    f"{path} {what}; continue it with --resume, move it aside with --overwrite, or choose another --out"
                )
            path.mkdir(parents=True, exist_ok=True)
            if occupied:
                self._resume(config)
            else:
                write_file(path / CONFIG, dump_yaml(config).encode())
            shutil.rmtree(path / STAGING, ignore_errors=True)
        except OSError as error:
            raise ResourceError(f"{path} cannot be written: {error.strerror or error}; choose another --out") from error

    @property
    def episodes(self) -> int:
        """How many episodes are published or in the ledger, the missing ones included."""
        return sum(attempt.episode is not None for attempt in self.attempts)

    @property
    def missing(self) -> list[AttemptRecord]:
        """Attempts whose episode is in the ledger but not on the disk: it has to be made again."""
        return [
            attempt for attempt in self.attempts if attempt.episode is not None and attempt.episode not in self._entries
        ]

    def publish(self, record: EpisodeRecord, files: dict[str, bytes]) -> None:
        """Make one episode visible, all of it at once.

        Raises:
            OSError: nothing of it is visible.
        """
        name = episode_name(record.episode)
        text = to_json(record)
        publish_directory(self.path / name, {**files, EPISODE: text}, self.path / STAGING)
        self._entries[record.episode] = _entry(record, text, sum(map(len, files.values())))

    def log(self, attempt: AttemptRecord) -> None:
        """Add one attempt to the ledger; attempts come in order."""
        append_line(self.path / ATTEMPTS, to_json(attempt).decode().rstrip("\n"))
        self.attempts.append(attempt)

    def finish(self) -> Manifest:
        """Write the manifest of what is published, and clean up."""
        entries = [self._entries[number] for number in sorted(self._entries)]
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

    def _resume(self, config: dict[str, Any]) -> None:
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
                "run with the same values, or record into another --out"
            )
        self.attempts = read_attempts(self.path)
        ledger = self.path / ATTEMPTS
        if ledger.is_file() and not ledger.read_bytes().endswith(b"\n"):
            # Cut off: appending after it would leave the damaged line in the middle, where it counts as damage.
            write_file(ledger, b"".join(map(to_json, self.attempts)))
        known = {attempt.episode: attempt for attempt in self.attempts}
        for number, directory in episode_directories(self.path):
            text = (directory / EPISODE).read_bytes() if (directory / EPISODE).is_file() else b""
            record = from_json(EpisodeRecord, text, directory / EPISODE)
            if number not in known:
                # Published just before the crash, but not yet in the ledger.
                if record.attempt != len(self.attempts):
                    raise DatasetError(
                        f"{directory} is attempt {record.attempt}, but {ATTEMPTS} ends before it; it cannot be resumed"
                    )
                self.log(
                    AttemptRecord(
                        attempt=record.attempt,
                        seed=record.seed,
                        episode=number,
                        outcome=record.outcome,
                        layout=record.layout,
                    )
                )
            size = sum((directory / name).stat().st_size for name in record.files if (directory / name).is_file())
            self._entries[number] = _entry(record, text, size)


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


def _differences(recorded: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """`key: recorded value, wanted value` for every value that differs."""
    old, new = _flatten(recorded), _flatten(wanted)
    return [
        f"{key}: {old.get(key)!r} there, {new.get(key)!r} now"
        for key in dict.fromkeys([*old, *new])
        if old.get(key) != new.get(key)
    ]
