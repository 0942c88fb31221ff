"""The dataset that an export reads: its episodes one by one, each whole and all of one kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..config.recording import RecordConfig
from ..dataset.layout import depth_name
from ..dataset.reader import StoredEpisode, dataset_config, open_episode
from ..dataset.selection import select_episodes
from ..errors import DatasetError
from ..resources import Locations

# Called with episodes done and in all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Exported:
    """What an export wrote.

    Attributes:
        path: the directory, or the file.
        episodes, frames: how many it holds.
        moved_aside: where what was at `path` before has gone, if it was moved.
    """

    path: Path
    episodes: int
    frames: int
    moved_aside: Path | None = None


@dataclass(frozen=True)
class Source:
    """Episodes of one dataset, all with the same cameras and the same frame period.

    Attributes:
        path: of the dataset.
        config: it was recorded with.
        directories: of the chosen episodes, in order.
        first: the first of them.
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
        """What the names of each arm's parts begin with, in the order of recordings; nothing for a lone arm."""
        rig = self.config.rig
        return tuple(f"{rig.arms[k].side}_" for k in rig.recorded) if len(rig.arms) > 1 else ("",)

    @property
    def frame_period(self) -> float:
        """From one frame to the next, s."""
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
    """Look at a dataset before anything is written.

    Args:
        episodes: which, such as `0,3,5-9`; None for all.

    Raises:
        DatasetError: there is no dataset, or it is damaged.
        UsageError: an episode is named that is not there.
    """
    chosen = select_episodes(dataset, episodes, None)
    directories = tuple(directory for _, directory in chosen)
    return Source(dataset, dataset_config(dataset, locations), directories, open_episode(directories[0]))


def depth_cameras(episode: StoredEpisode) -> tuple[str, ...]:
    """The cameras of which an episode holds depth."""
    return tuple(camera for camera in episode.record.cameras if depth_name(camera, 0) in episode.record.files)
