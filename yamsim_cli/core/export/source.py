"""The dataset that an export reads, episode by episode; see `real_source` for recordings of real arms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..dataset.layout import depth_name
from ..dataset.reader import RecordedEpisode, StoredEpisode, dataset_config, open_episode, select_episodes
from ..dataset.rows import drive_names, prefixes, weld_names
from ..errors import DatasetError
from ..resources import Locations


@dataclass(frozen=True)
class Exported:
    """What an export wrote.

    Attributes:
        path: the directory or file that was written.
        episodes, frames: how many it holds.
        moved_aside: the new place of what was at `path` before; None if nothing was.
        notes: for a person: where what was written is not what was recorded.
    """

    path: Path
    episodes: int
    frames: int
    moved_aside: Path | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class AnySource(ABC):
    """Episodes of one dataset, simulated or real, all with the same cameras.

    Attributes:
        path: the dataset's directory.
        directories: directories of the chosen episodes, in order.
        first: the first of the episodes.
    """

    path: Path
    directories: tuple[Path, ...]
    first: RecordedEpisode

    def __len__(self) -> int:
        return len(self.directories)

    @property
    @abstractmethod
    def rig(self) -> RigConfig:
        """Whose arms were recorded."""

    @abstractmethod
    def episodes(self) -> Iterator[RecordedEpisode]:
        """The episodes, opened one after the other.

        Raises:
            DatasetError: one is damaged, or of another kind than the first.
        """

    @property
    def cameras(self) -> dict[str, tuple[int, int]]:
        """Camera -> width and height of its images, px."""
        return self.first.record.cameras

    @property
    def prefixes(self) -> tuple[str, ...]:
        """The prefix of the names of each arm's parts, in the order of recordings; empty for a lone arm."""
        return prefixes(self.rig)

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of all drives, and of what `joints` holds, in the order of recordings."""
        return drive_names(self.rig)

    @property
    def frame_period(self) -> float:
        """Time from one frame to the next, s."""
        return self.first.record.frame_period_s


@dataclass(frozen=True)
class Source(AnySource):
    """Simulated episodes of one dataset, all with the same cameras and the same frame period.

    Attributes:
        config: the config that it was recorded with.
    """

    first: StoredEpisode
    config: RecordConfig

    @property
    def rig(self) -> RigConfig:
        """Whose arms were recorded."""
        return self.config.rig

    @property
    def welds(self) -> tuple[str, ...]:
        """Names of what an action says of each arm's weld."""
        return weld_names(self.config)

    def episodes(self) -> Iterator[StoredEpisode]:
        """The episodes, opened one after the other.

        Raises:
            DatasetError: one is damaged, or of another kind than the first.
        """
        for directory in self.directories:
            episode = open_episode(directory)
            require_alike(episode, self.first, ("cameras", "frame_period_s", "objects", "arms"))
            yield episode


def require_alike(episode: RecordedEpisode, first: RecordedEpisode, keys: Sequence[str]) -> None:
    """Make sure that an episode is of one kind with the first.

    Args:
        keys: of their records.

    Raises:
        DatasetError: it is not.
    """
    for what in keys:
        mine, others = getattr(episode.record, what), getattr(first.record, what)
        if mine != others:
            raise DatasetError(
                f"{episode.directory} has other {what} than {first.directory.name} ({mine}, not {others}): "
                "export them apart, see --episodes"
            )


def open_source(dataset: Path, episodes: str | None, locations: Locations) -> Source:
    """The chosen episodes of a simulated dataset.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.

    Raises:
        DatasetError: there is no dataset, it is damaged, or holds real recordings.
        UsageError: an episode is named that is not there.
    """
    chosen = select_episodes(dataset, episodes, None)
    directories = tuple(directory for _, directory in chosen)
    return Source(dataset, directories, open_episode(directories[0]), dataset_config(dataset, locations))


def depth_cameras(episode: StoredEpisode) -> tuple[str, ...]:
    """The cameras with depth images in an episode."""
    return tuple(camera for camera in episode.record.cameras if depth_name(camera, 0) in episode.record.files)
