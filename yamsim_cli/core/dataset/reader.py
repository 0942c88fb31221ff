"""Published episodes, read back file by file. Their content is not trusted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, SupportsIndex, overload

from ..config.loader import parse_config
from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..errors import ConfigError, DatasetError, UsageError, counted
from ..files import sha256_bytes
from ..resources import Locations
from .checks.context import find_episodes
from .checks.lowdim import frame_faults, recorded_forms
from .layout import CONFIG, EPISODE, episode_directories, episode_name, image_name, lowdim_name
from .lowdim import load_frame
from .real import RealRecord, is_real, real_config
from .records import EpisodeRecord, from_json

# Our own records are written with this; whoever writes one by other means has to keep to JSON's usual spacing.
_SAYS_REAL = re.compile(rb'"source"\s*:\s*"real"')


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode on the disk, simulated or real: its directory, and the content of its `episode.json`."""

    directory: Path
    record: EpisodeRecord | RealRecord

    @property
    def dataset(self) -> Path:
        """The directory of the dataset that it belongs to."""
        return self.directory.absolute().parent

    def read(self, name: str) -> bytes:
        """Content of one file by its path inside the episode, whether it was altered or not.

        Raises:
            DatasetError: it cannot be read.
        """
        try:
            return (self.directory / name).read_bytes()
        except OSError as error:
            raise DatasetError(f"{self.directory / name} cannot be read: {error.strerror or error}") from error

    def altered(self, name: str, data: bytes) -> bool:
        """Whether a file's content differs from what was recorded."""
        return sha256_bytes(data) != self.record.files.get(name)

    def whole(self, name: str) -> bytes:
        """Content of one file, as it was recorded.

        Raises:
            DatasetError: it cannot be read, or was altered.
        """
        data = self.read(name)
        if self.altered(name, data):
            raise DatasetError(
                f"{self.directory / name} is not what was recorded: its sha256 differs from that in {EPISODE}; "
                "copy the episode anew, or record it again"
            )
        return data

    def frame(self, number: int, data: bytes) -> dict[str, Any]:
        """The low-dimensional data of one frame, from its file's content.

        Raises:
            DatasetError: it is damaged.
        """
        try:
            return load_frame(data)
        except DatasetError as error:
            raise DatasetError(f"{self.directory / lowdim_name(number)}: {error}") from error

    def frames(self) -> list[dict[str, Any]]:
        """The low-dimensional data of all frames, each one as it was recorded.

        Raises:
            DatasetError: a file is missing, damaged or altered.
        """
        return [self.frame(k, self.whole(lowdim_name(k))) for k in range(self.record.frames)]

    def image(self, camera: str, number: int) -> bytes:
        """A frame's JPEG as it was recorded.

        Raises:
            DatasetError: it is missing or altered.
        """
        return self.whole(image_name(camera, number))


@dataclass(frozen=True)
class StoredEpisode(RecordedEpisode):
    """An episode that was simulated."""

    record: EpisodeRecord

    def frame(self, number: int, data: bytes) -> dict[str, Any]:
        """The low-dimensional data of one frame, from its file's content.

        Raises:
            DatasetError: it is damaged, or holds other data.
        """
        frame = super().frame(number, data)
        faults = frame_faults(frame, recorded_forms(self.record))
        if faults:
            raise DatasetError(f"{self.directory / lowdim_name(number)}: {'; '.join(faults)}")
        return frame


def open_episode(directory: Path) -> StoredEpisode:
    """The simulated episode in a directory.

    Raises:
        DatasetError: there is no episode, its record is damaged, or it is a real one.
    """
    episode = open_recorded(directory)
    if not isinstance(episode, StoredEpisode):
        raise DatasetError(f"{directory} is a real recording: it was not simulated, so that cannot be done with it")
    return episode


def open_recorded(directory: Path) -> RecordedEpisode:
    """The episode in a directory, simulated or real.

    Raises:
        DatasetError: there is no episode, or its record is damaged.
    """
    file = directory / EPISODE
    try:
        text = file.read_bytes()
    except OSError as error:
        raise DatasetError(
            f"{directory} is no episode: {EPISODE} cannot be read ({error.strerror or error}); "
            "give a directory such as dataset/ep_000003"
        ) from error
    if _SAYS_REAL.search(text):
        return RecordedEpisode(directory, from_json(RealRecord, text, file))
    return StoredEpisode(directory, from_json(EpisodeRecord, text, file))


def recorded_episodes(dataset: Path) -> list[RecordedEpisode]:
    """All episodes of a dataset in our format, simulated or real.

    Raises:
        DatasetError: there is no dataset, or a record of it is damaged.
    """
    found, recorded = find_episodes(dataset)
    if not recorded and not is_real(dataset):
        raise _plain(dataset)
    return [open_recorded(episode.path) for episode in found]


class StoredEpisodes(Sequence[StoredEpisode]):
    """Episodes of a dataset, in order. An episode is read each time when it is asked for.

    Attributes:
        path: the dataset's directory.
    """

    def __init__(self, path: Path, directories: Sequence[Path]) -> None:
        self.path = path
        self._directories = tuple(directories)

    def __len__(self) -> int:
        return len(self._directories)

    @overload
    def __getitem__(self, key: SupportsIndex) -> StoredEpisode: ...

    @overload
    def __getitem__(self, key: slice) -> StoredEpisodes: ...

    def __getitem__(self, key: SupportsIndex | slice) -> StoredEpisode | StoredEpisodes:
        """One episode by its place, counted from the end if negative, or several by a slice.

        Raises:
            IndexError: there are fewer episodes.
            DatasetError: its record is missing or damaged.
        """
        if isinstance(key, slice):
            return StoredEpisodes(self.path, self._directories[key])
        try:
            directory = self._directories[key]
        except IndexError:
            raise IndexError(f"{self.path} has {counted(len(self), 'episode')}, and none at place {key}") from None
        return open_episode(directory)

    def __repr__(self) -> str:
        return f"<{counted(len(self), 'episode')} of {self.path}>"


def open_episodes(dataset: Path) -> StoredEpisodes:
    """The episodes of a dataset.

    Raises:
        DatasetError: there is no dataset, or yamsim did not record it.
    """
    found, recorded = find_episodes(dataset)
    if not recorded:
        raise _plain(dataset)
    return StoredEpisodes(dataset, [episode.path for episode in found])


def _plain(dataset: Path) -> DatasetError:
    return DatasetError(
        f"{dataset} is a plain recording, without {CONFIG} and {EPISODE}: `yamsim summarize` can check it, but its "
        "episodes cannot be opened; give the directory that `yamsim record` wrote, or bring it in with `yamsim import`"
    )


def find_episode(path: Path, number: int | None) -> RecordedEpisode:
    """The episode at a path: its own directory, or its dataset's with a number.

    Raises:
        UsageError: the path is a dataset, and there is no number, or no episode of that number.
        DatasetError: there is no episode, or its record is damaged.
    """
    there = episode_directories(path) if path.is_dir() else []
    if number is None and not there:
        return open_recorded(path)
    names = ", ".join(directory.name for _, directory in there[:3]) + (", ..." if len(there) > 3 else "")
    if number is None:
        raise UsageError(f"{path} is a dataset: give one of its episodes ({names}), or --episode")
    if number not in dict(there):
        raise UsageError(f"--episode {number}: there is no {episode_name(number)} in {path}; it has {names or 'none'}")
    return open_recorded(dict(there)[number])


def dataset_config(dataset: Path, locations: Locations) -> RecordConfig:
    """The configuration that a dataset was recorded with.

    Raises:
        DatasetError: the dataset has none, or it cannot be used.
    """
    file = dataset / CONFIG
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise DatasetError(
            f"{file} cannot be read ({reason}): without it nothing of the dataset can be simulated again"
        ) from error
    if is_real(dataset):
        raise DatasetError(
            f"{dataset} holds real recordings: they were not simulated, so nothing can make them again; "
            f"yamsim summarize {dataset} --strict checks every file by its hash, and yamsim gap {dataset} how far the "
            "simulation is from them"
        )
    try:
        return parse_config(RecordConfig, text, str(file), locations, as_recorded=True)
    except ConfigError as error:
        raise DatasetError(f"{error}; was it recorded by another version of yamsim?") from error


def recorded_rig(dataset: Path, locations: Locations) -> RigConfig:
    """Whose arms a dataset has, simulated or real.

    Raises:
        DatasetError: it has no configuration, or one that cannot be used.
    """
    return real_config(dataset, locations).rig if is_real(dataset) else dataset_config(dataset, locations).rig
