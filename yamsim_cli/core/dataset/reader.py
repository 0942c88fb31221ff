"""A published episode, read back file by file; nothing of it is trusted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config.loader import parse_config
from ..config.record import RecordConfig
from ..errors import ConfigError, DatasetError, UsageError
from ..files import sha256_bytes
from ..resources import Locations
from .checks.lowdim import frame_faults
from .layout import CONFIG, EPISODE, episode_directories, episode_name, image_name, lowdim_name
from .lowdim import load_frame
from .records import EpisodeRecord, from_json


@dataclass(frozen=True)
class StoredEpisode:
    """An episode on the disk: its directory, and what its `episode.json` says."""

    directory: Path
    record: EpisodeRecord

    @property
    def dataset(self) -> Path:
        """The dataset it belongs to."""
        return self.directory.absolute().parent

    def read(self, name: str) -> bytes:
        """Content of one file by its path inside the episode, as it is.

        Raises:
            DatasetError: it cannot be read.
        """
        try:
            return (self.directory / name).read_bytes()
        except OSError as error:
            raise DatasetError(f"{self.directory / name} cannot be read: {error.strerror or error}") from error

    def altered(self, name: str, data: bytes) -> bool:
        """Whether a file's content is another than the one that was recorded."""
        return sha256_bytes(data) != self.record.files.get(name)

    def whole(self, name: str) -> bytes:
        """Content of one file, which is what was recorded.

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
            DatasetError: it is damaged, or not such data.
        """
        try:
            frame = load_frame(data)
        except DatasetError as error:
            raise DatasetError(f"{self.directory / lowdim_name(number)}: {error}") from error
        if faults := frame_faults(frame, self.record.objects, self.record.cameras, self.record.arms):
            raise DatasetError(f"{self.directory / lowdim_name(number)}: {'; '.join(faults)}")
        return frame

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


def open_episode(directory: Path) -> StoredEpisode:
    """Read what an episode says of itself.

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
    return StoredEpisode(directory, from_json(EpisodeRecord, text, file))


def find_episode(path: Path, number: int | None) -> StoredEpisode:
    """The episode at a path: its own directory, or its dataset's with a number.

    Raises:
        UsageError: a dataset without a number, or one it has no episode of.
        DatasetError: there is no episode, or its record is damaged.
    """
    there = episode_directories(path) if path.is_dir() else []
    if number is None and not there:
        return open_episode(path)
    names = ", ".join(directory.name for _, directory in there[:3]) + (", ..." if len(there) > 3 else "")
    if number is None:
        raise UsageError(f"{path} is a dataset: give one of its episodes ({names}), or --episode")
    if number not in dict(there):
        raise UsageError(f"--episode {number}: there is no {episode_name(number)} in {path}; it has {names or 'none'}")
    return open_episode(dict(there)[number])


def dataset_config(dataset: Path, locations: Locations) -> RecordConfig:
    """The configuration a dataset was recorded with.

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
    try:
        return parse_config(RecordConfig, text, str(file), locations, as_recorded=True)
    except ConfigError as error:
        raise DatasetError(f"{error}; was it recorded by another version of yamsim?") from error
