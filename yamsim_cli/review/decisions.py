"""The selection file of a review in progress: one process writes it, decision by decision."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from ..core.closable import Closable
from ..core.dataset.dataset_paths import episode_name
from ..core.dataset.reader import open_recorded_episode
from ..core.dataset.writing.directory_claim import DirectoryLock
from ..core.errors import DatasetError, ResourceError, UsageError
from ..selection import EpisodeDecision, Selection, episode_hash, read_selection, write_selection


class DecisionFile(Closable):
    """The decisions of a review. Each change is on the disk before it is confirmed.

    Attributes:
        path: the selection file.
        undecided: what becomes of episodes without a decision.
        stale: numbers of episodes whose content has changed since they were decided. They are undecided again.
    """

    def __init__(
        self, path: Path, dataset: Path, directories: Mapping[int, Path], undecided: Literal["keep", "drop"] | None
    ) -> None:
        """Lock the file for this process, and read it if it exists.

        Args:
            directories: episode number -> directory.
            undecided: what becomes of undecided episodes; None for the value in the file, or to keep them.

        Raises:
            ResourceError: another review writes the file, or its folder cannot be written.
            ConfigError: the file is invalid.
            DatasetError: the file belongs to other episodes.
        """
        self.path = path
        self.stale: list[int] = []
        self._directories = directories
        self._lock = _lock(path)
        try:
            found = read_selection(path) if path.exists() else Selection(dataset.absolute().name, "keep", {})
            self.undecided = undecided or found.undecided
            self._dataset = found.dataset
            self.decisions = {number: self._renewed(found, number) for number in found.decisions}
            if self.stale and len(self.stale) == len(self.decisions):
                raise DatasetError(
                    f"{path}: all its decisions are stale, the first one on {episode_name(self.stale[0])}; give the "
                    f"dataset that was reviewed ({found.dataset or 'unnamed'}), or another --out"
                )
        except BaseException:
            self.close()
            raise

    def _renewed(self, found: Selection, number: int) -> EpisodeDecision:
        decision = found.decisions[number]
        if number not in self._directories:
            raise DatasetError(
                f"{self.path}: {episode_name(number)} is not in the dataset; give the dataset that was reviewed "
                f"({found.dataset or 'unnamed'}), or another --out"
            )
        sha256 = episode_hash(self._directories[number])
        if sha256 == decision.sha256:
            return decision
        self.stale.append(number)
        cleared = {"decision": "undecided", "first_frame": None, "last_frame": None}
        return decision.model_copy(update={"sha256": sha256, **cleared})

    def decide(self, number: int, values: Mapping[str, Any], reviewer: str) -> EpisodeDecision | None:
        """Store the decision on an episode, and return it; None if nothing is decided any more.

        Args:
            values: `decision`, `first_frame`, `last_frame`, `tags` and `note`; a missing value means no decision.

        Raises:
            UsageError: a value is invalid.
            DatasetError: the episode is missing or damaged.
            ResourceError: the file could not be written; it keeps the earlier decisions.
        """
        directory = self._directories.get(number)
        if directory is None:
            raise DatasetError(f"{episode_name(number)} is not in the dataset")
        allowed = {key: values[key] for key in ("first_frame", "last_frame", "tags", "note") if key in values}
        try:
            made = EpisodeDecision(
                episode=number,
                decision=values.get("decision", "undecided"),
                sha256=episode_hash(directory),
                reviewer=reviewer,
                **allowed,
            )
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise UsageError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
        frames = open_recorded_episode(directory).record.frames if made.is_trimmed else 0
        if made.is_trimmed and not max(made.first_frame or 0, made.last_frame or 0) < frames:
            raise UsageError(f"first_frame and last_frame of {episode_name(number)} must lie in 0..{frames - 1}")
        decisions = {**self.decisions, number: made}
        if made.is_empty:
            del decisions[number]
        try:
            write_selection(self.path, Selection(self._dataset, self.undecided, decisions))
        except OSError as error:
            raise ResourceError(
                f"{self.path} cannot be written: {error.strerror}; the decision is not stored"
            ) from error
        self.decisions = decisions
        return None if made.is_empty else made

    def close(self) -> None:
        """Let another review write the file."""
        self._lock.release()


def _lock(path: Path) -> DirectoryLock:
    """Lock a selection file for this process."""
    try:
        return DirectoryLock.acquire(path.parent, name=f".{path.name}.lock", used=f"{path} is being written")
    except OSError as error:
        raise ResourceError(f"{path.parent} cannot be written: {error.strerror}; choose another --out") from error
