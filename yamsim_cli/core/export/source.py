"""The dataset that an export reads, episode by episode; all of them have the same cameras and frame period."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..config.recording import RecordConfig
from ..dataset.layout import depth_name
from ..dataset.reader import StoredEpisode, dataset_config, open_episode
from ..dataset.rows import drive_names, prefixes, weld_names
from ..dataset.selection import select_episodes
from ..errors import DatasetError
from ..resources import Locations


@dataclass(frozen=True)
class Exported:
    """What an export wrote.

    Attributes:
        path: the directory or file that was written.
        episodes, frames: how many it holds.
        moved_aside: the new place of what was at `path` before; None if nothing was.
    """

    path: Path
    episodes: int
    frames: int
    moved_aside: Path | None = None


@dataclass(frozen=True)
class Source:
    """Episodes of one dataset, all with the same cameras and the same frame period.

    Attributes:
        path: the dataset's directory.
        config: the config that it was recorded with.
        directories: directories of the chosen episodes, in order.
        first: the first of the episodes.
    """

    path: Path
    config: RecordConfig
    directories: tuple[Path, ...]
    first: StoredEpisode

    def __len__(self) -> int:
        return len(self.directories)

    @property
    def cameras(self) -> dict[str, tuple[int, int]]:
        """Camera -> width and height of its images, px."""
        return self.first.record.cameras

    @property
    def prefixes(self) -> tuple[str, ...]:
        """The prefix of the names of each arm's parts, in the order of recordings; empty for a lone arm."""
        return prefixes(self.config.rig)

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of all drives, and of what `joints` holds, in the order of recordings."""
        return drive_names(self.config.rig)

    @property
    def welds(self) -> tuple[str, ...]:
        """Names of what an action says of each arm's weld."""
        return weld_names(self.config)

    @property
    def frame_period(self) -> float:
        """Time from one frame to the next, s."""
        return self.first.record.frame_period_s

    def episodes(self) -> Iterator[StoredEpisode]:
        """The episodes, opened one after the other.

        Raises:
            DatasetError: one is damaged, or of another kind than the first.
        """
        for directory in self.directories:
            episode = open_episode(directory)
            for what in ("cameras", "frame_period_s", "objects", "arms"):
                mine, others = getattr(episode.record, what), getattr(self.first.record, what)
                if mine != others:
                    raise DatasetError(
                        f"{directory} has other {what} than {self.first.directory.name} ({mine}, not {others}): "
                        "export them apart, see --episodes"
                    )
            yield episode


def open_source(dataset: Path, episodes: str | None, locations: Locations) -> Source:
    """The chosen episodes of a dataset.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.

    Raises:
        DatasetError: there is no dataset, or it is damaged.
        UsageError: an episode is named that is not there.
    """
    chosen = select_episodes(dataset, episodes, None)
    directories = tuple(directory for _, directory in chosen)
    return Source(dataset, dataset_config(dataset, locations), directories, open_episode(directories[0]))


def depth_cameras(episode: StoredEpisode) -> tuple[str, ...]:
    """The cameras with depth images in an episode."""
    return tuple(camera for camera in episode.record.cameras if depth_name(camera, 0) in episode.record.files)
