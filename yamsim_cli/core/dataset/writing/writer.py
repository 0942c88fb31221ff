"""Write a dataset from one process, episode by episode. The dataset is consistent after every step."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...closable import Closable
from ...config.recording import RecordConfig
from ...errors import DatasetError, ResourceError, join_ranges
from ...files.documents.yaml_document import dump_yaml, parse_yaml
from ...files.writing import append_line, publish_directory, sha256_bytes, write_file
from ..dataset_paths import (
    CONFIG_FILE,
    EPISODE_FILE,
    LEDGER_FILE,
    MANIFEST_FILE,
    PROVENANCE_FILE,
    STAGING_FOLDER,
    episode_name,
)
from ..disk_errors import describe_disk_error
from ..records import AttemptRecord, EpisodeRecord, Manifest, ManifestEntry, to_json
from ..upgrade import upgrade_config
from .directory_claim import (
    MESHES_KEY,
    ExistingDatasetMode,
    claim_directory,
    describe_unstated_meshes,
    require_same_config,
)
from .integrity import InspectedEpisode, inspect_episodes, quarantine_episode
from .ledger import Ledger, placeholder_record


class AttemptLog:
    """Attempts and episodes that a writer has recorded.

    Attributes:
        path: the dataset directory.
        attempts: all attempts so far, in order.
        episodes: number of successful attempts, which are stored as episodes.
        lost_lines: numbers of attempts whose ledger lines are lost. They count as failures until they are logged again.
        repairs: one sentence for each damaged or missing part that was found, with its repair.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.attempts: list[AttemptRecord] = []
        self.episodes = 0
        self.lost_lines: set[int] = set()
        self.repairs: list[str] = []

    def _add_attempt(self, attempt: AttemptRecord) -> None:
        self.attempts.append(attempt)
        self.episodes += attempt.episode is not None

    def _restore_lost_attempt(self, attempt: AttemptRecord) -> None:
        self.lost_lines.remove(attempt.attempt)
        self.attempts[attempt.attempt] = attempt
        self.episodes += attempt.episode is not None


class DatasetWriter(AttemptLog, Closable):
    """Publishes episodes and maintains the attempt ledger and the manifest. A context manager.

    Attributes:
        config: all settings that determine the data, as in the dataset's config.yaml.
        moved_aside: path of the backup of an earlier dataset, with `ExistingDatasetMode.OVERWRITE`.
        entries: episode number -> entry in the manifest.
    """

    def __init__(
        self, path: Path, config: Mapping[str, Any], mode: ExistingDatasetMode, *, locks_reach_others: bool = True
    ) -> None:
        """Open a dataset for writing. No other recorder can open the dataset until `close`.

        Args:
            config: all settings that determine the data, JSON-ready.
            locks_reach_others: whether the filesystem's locks work between machines.

        Raises:
            UsageError: `path` is not empty, or not a directory, and `mode` does not allow that.
            ConfigError: the resumed dataset has a different configuration; the message names the keys.
            DatasetError: the resumed directory is not a dataset, or its episodes and ledger contradict each other.
            ResourceError: the directory cannot be created or written, or another recorder holds it.
        """
        super().__init__(path)
        self.config = config
        self._ledger: Ledger | None = None
        self.entries: dict[int, ManifestEntry] = {}
        self._task = str(config["task"]["name"])
        self._seed = int(config["seed"])
        try:
            held = claim_directory(path, mode, locks_reach_others=locks_reach_others)
            self._lock, self.moved_aside = held.lock, held.moved_aside
            try:
                if held.occupied:
                    self._resume_dataset(config)
                else:
                    write_file(path / CONFIG_FILE, dump_yaml(config).encode())
            except BaseException:
                self.close()
                raise
        except OSError as error:
            raise ResourceError(
                f"{path} cannot be written: {describe_disk_error(error, path)}; choose another --out"
            ) from error

    @property
    def attempts_without_episode(self) -> list[AttemptRecord]:
        """Attempts whose episodes are in the ledger but not on disk."""
        return [
            attempt for attempt in self.attempts if attempt.episode is not None and attempt.episode not in self.entries
        ]

    def publish_episode(self, record: EpisodeRecord, files: Mapping[str, bytes]) -> None:
        """Publish one episode atomically. After an OSError no part of the episode is visible."""
        name = episode_name(record.episode)
        text = to_json(record)
        publish_directory(self.path / name, {**files, EPISODE_FILE: text}, self.path / STAGING_FOLDER)
        self.entries[record.episode] = _manifest_entry(record, text, sum(map(len, files.values())))

    def log_attempt(self, attempt: AttemptRecord) -> None:
        """Add an attempt to the ledger: the next one in order, or one of `lost_lines`. Publish its episode first."""
        if attempt.attempt not in self.lost_lines:
            append_line(self.path / LEDGER_FILE, to_json(attempt).decode().rstrip("\n"))
            self._add_attempt(attempt)
            return
        assert self._ledger is not None
        self._ledger.insert_lost_attempt(attempt)
        self._restore_lost_attempt(attempt)

    def write_manifest(self) -> Manifest:
        """Write and return the manifest of all published episodes, and remove the staging directory."""
        entries = [self.entries[number] for number in sorted(self.entries)]
        manifest = Manifest(
            task=self._task,
            seed=self._seed,
            attempts=len(self.attempts),
            frames=sum(entry.frames for entry in entries),
            bytes=sum(entry.bytes for entry in entries),
            episodes=entries,
        )
        write_file(self.path / MANIFEST_FILE, to_json(manifest, indent=1))
        shutil.rmtree(self.path / STAGING_FOLDER, ignore_errors=True)
        return manifest

    def close(self) -> None:
        """Release the directory for other recorders."""
        self._lock.release()

    def _resume_dataset(self, config: Mapping[str, Any]) -> None:
        self._check_config(config)
        ledger = Ledger(self.path)
        ledger.restore_lost_lines(
            [
                record
                for found in inspect_episodes(self.path)
                if (record := self._keep_or_quarantine_episode(found)) is not None
            ]
        )
        self._load_attempts(ledger)
        for attempt in self.attempts_without_episode:
            place = self.path / episode_name(attempt.episode or 0)
            if place.exists():
                self.repairs.append(
                    f"{place.name} is not a directory; moved to {quarantine_episode(place)}, to be recorded again"
                )

    def _load_attempts(self, ledger: Ledger) -> None:
        kept, self.lost_lines = ledger.repair_file(), ledger.missing_attempts
        if kept is not None:
            self.repairs.append(f"{LEDGER_FILE} was damaged ({ledger.fault}): repaired; the damaged file is {kept}")
        if self.lost_lines:
            self._ledger = ledger
            numbers = join_ranges(sorted(self.lost_lines))
            self.repairs.append(f"the line of attempt {numbers} in {LEDGER_FILE} is lost")
        for number in range(max(ledger.known_attempts, default=-1) + 1):
            self._add_attempt(ledger.known_attempts.get(number) or placeholder_record(number, self._seed))

    def _check_config(self, config: Mapping[str, Any]) -> None:
        file = self.path / CONFIG_FILE
        if (self.path / PROVENANCE_FILE).is_file():
            raise DatasetError(
                f"{self.path} was made from other datasets, so it cannot be resumed; record into another --out, and "
                "merge the two with `yamsim merge`"
            )
        if not file.is_file():
            raise DatasetError(f"{self.path} has no {CONFIG_FILE}, so it cannot be resumed; choose another --out")
        recorded = upgrade_config(parse_yaml(file.read_bytes(), str(file)).data)
        if config.get(MESHES_KEY) is not None and recorded.get(MESHES_KEY) is None:
            # Resume the dataset without meshes: they would be useless in only some of the episodes.
            self.config = {**config, MESHES_KEY: None}
            self.repairs.append(describe_unstated_meshes(self.path, config))
        require_same_config(self.path, recorded, self.config)

    def _keep_or_quarantine_episode(self, found: InspectedEpisode) -> EpisodeRecord | None:
        record, fault = found.record, found.fault
        if record is None or fault is not None:
            self.repairs.append(
                f"{found.directory.name}: {fault}; moved to {quarantine_episode(found.directory)}, to be recorded again"
            )
            return None
        self.entries[found.number] = _manifest_entry(record, found.text, found.size)
        return record


def config_for_new_episodes(config: RecordConfig, writer: DatasetWriter) -> RecordConfig:
    """Return the config for new episodes: `meshes` is None if the config of the dataset does not state them."""
    return config if writer.config.get(MESHES_KEY) is not None else config.model_copy(update={"meshes": None})


def _manifest_entry(record: EpisodeRecord, text: bytes, size: int) -> ManifestEntry:
    return ManifestEntry(
        episode=record.episode,
        path=episode_name(record.episode),
        attempt=record.attempt,
        frames=record.frames,
        bytes=size + len(text),
        sha256=sha256_bytes(text),
    )
