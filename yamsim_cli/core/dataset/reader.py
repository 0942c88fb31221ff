"""Reads published episodes: finds and selects them, and opens their files, whose content is not trusted."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, SupportsIndex, overload

import numpy as np

from ..config.loader import parse_config
from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..errors import ConfigError, DatasetError, UsageError, count_noun, join_ranges
from ..files.resources import Locations
from ..files.writing import sha256_bytes
from ..images.image import Image
from .checks.context import find_episodes
from .checks.lowdim import frame_faults, recorded_specs
from .dataset_paths import CONFIG, EPISODE, episode_directories, episode_name, image_name, lowdim_name
from .imported_records import RealEpisodeRecord, is_real, real_config
from .lowdim import load_frame
from .records import EpisodeRecord, from_json

_REAL_SOURCE = re.compile(rb'"source"\s*:\s*"real"')  # in the `episode.json` of an imported recording
_EPISODE_RANGE = re.compile(r"^(?:ep_)?(\d+)(?:-(?:ep_)?(\d+))?$")


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode on the disk, simulated or real: its directory, and the content of its `episode.json`."""

    directory: Path
    record: EpisodeRecord | RealEpisodeRecord

    @property
    def dataset(self) -> Path:
        """The dataset's directory."""
        return self.directory.absolute().parent

    def read(self, name: str) -> bytes:
        """Content of one file by its path inside the episode, altered or not; DatasetError if unreadable."""
        try:
            return (self.directory / name).read_bytes()
        except OSError as error:
            raise DatasetError(f"{self.directory / name} cannot be read: {error.strerror or error}") from error

    def altered_files(self, name: str, data: bytes) -> bool:
        """Whether a file's content differs from what was recorded."""
        return sha256_bytes(data) != self.record.files.get(name)

    def read_verified(self, name: str) -> bytes:
        """Content of one file as recorded; DatasetError if the file cannot be read or was altered."""
        data = self.read(name)
        if self.altered_files(name, data):
            raise DatasetError(
                f"{self.directory / name} is not what was recorded: its sha256 differs from that in {EPISODE}; "
                "copy the episode anew, or record it again"
            )
        return data

    def frame(self, number: int, data: bytes) -> dict[str, Any]:
        """The low-dimensional data of one frame, from its file's content; DatasetError if damaged."""
        try:
            return load_frame(data)
        except DatasetError as error:
            raise DatasetError(f"{self.directory / lowdim_name(number)}: {error}") from error

    def frames(self) -> list[dict[str, Any]]:
        """The low-dimensional data of all frames; DatasetError if a file is missing, damaged or altered."""
        return [self.frame(k, self.read_verified(lowdim_name(k))) for k in range(self.record.frames)]

    def image(self, camera: str, number: int) -> bytes:
        """A frame's JPEG; DatasetError if the file is missing or altered."""
        return self.read_verified(image_name(camera, number))


@dataclass(frozen=True)
class StoredEpisode(RecordedEpisode):
    """An episode that was simulated."""

    record: EpisodeRecord

    def frame(self, number: int, data: bytes) -> dict[str, Any]:
        """As `RecordedEpisode.frame`; DatasetError too if keys, shapes or types are not those of the record."""
        frame = super().frame(number, data)
        faults = frame_faults(frame, recorded_specs(self.record))
        if faults:
            raise DatasetError(f"{self.directory / lowdim_name(number)}: {'; '.join(faults)}")
        return frame


def open_episode(directory: Path) -> StoredEpisode:
    """The simulated episode in a directory; raises as `open_recorded`, and DatasetError if the episode is real."""
    episode = open_recorded(directory)
    if not isinstance(episode, StoredEpisode):
        raise DatasetError(f"{directory} is an imported recording of real arms; give a simulated episode")
    return episode


def open_recorded(directory: Path) -> RecordedEpisode:
    """The episode in a directory, simulated or real; DatasetError if there is none, or its record is damaged."""
    file = directory / EPISODE
    try:
        text = file.read_bytes()
    except OSError as error:
        raise DatasetError(
            f"{directory} is no episode: {EPISODE} cannot be read ({error.strerror or error}); "
            "give a directory such as dataset/ep_000003"
        ) from error
    if _REAL_SOURCE.search(text):
        return RecordedEpisode(directory, from_json(RealEpisodeRecord, text, file))
    return StoredEpisode(directory, from_json(EpisodeRecord, text, file))


def recorded_episodes(dataset: Path) -> list[RecordedEpisode]:
    """All episodes of a dataset that yamsim recorded or imported.

    Raises:
        DatasetError: there is no such dataset, or one of its records is damaged.
    """
    found, recorded = find_episodes(dataset)
    if not recorded and not is_real(dataset):
        raise _not_recorded_error(dataset)
    return [open_recorded(episode.path) for episode in found]


class StoredEpisodes(Sequence[StoredEpisode]):
    """Episodes of a dataset, in order. An episode is read anew at each access; `path` is the dataset's directory."""

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
            DatasetError: the episode's record is missing or damaged.
        """
        if isinstance(key, slice):
            return StoredEpisodes(self.path, self._directories[key])
        try:
            directory = self._directories[key]
        except IndexError:
            raise IndexError(f"{self.path} has {count_noun(len(self), 'episode')}, and none at place {key}") from None
        return open_episode(directory)

    def __repr__(self) -> str:
        return f"<{count_noun(len(self), 'episode')} of {self.path}>"


def open_episodes(dataset: Path) -> StoredEpisodes:
    """The episodes of a dataset; DatasetError if there is no dataset, or yamsim did not record it."""
    found, recorded = find_episodes(dataset)
    if not recorded:
        raise _not_recorded_error(dataset)
    return StoredEpisodes(dataset, [episode.path for episode in found])


def _not_recorded_error(dataset: Path) -> DatasetError:
    return DatasetError(
        f"{dataset} is a plain recording, without {CONFIG} and {EPISODE}: `yamsim summarize` can check it, but its "
        "episodes cannot be opened; give the directory that `yamsim record` wrote, or bring it in with `yamsim import`"
    )


def find_episode(path: Path, number: int | None) -> RecordedEpisode:
    """The episode at a path: the episode's own directory, or its dataset's directory with a number.

    Raises:
        UsageError: the path is a dataset, and `number` is None or not one of its episodes.
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
    """The configuration that a dataset was recorded with; DatasetError if missing or invalid."""
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
    """The rig of a dataset, simulated or real; raises as `dataset_config`."""
    return real_config(dataset, locations).rig if is_real(dataset) else dataset_config(dataset, locations).rig


def select_episodes(dataset: Path, episodes: str | None, sample: int | None) -> list[tuple[int, Path]]:
    """Number and directory of selected episodes, in order.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.
        sample: how many episodes to select, spread evenly over the dataset; None for all.

    Raises:
        DatasetError: there is no dataset.
        UsageError: an episode does not exist, or `episodes` is not a list of numbers and ranges.
    """
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} is not a directory; give the directory that `yamsim record` wrote")
    there = dict(episode_directories(dataset))
    if not there:
        raise DatasetError(f"{dataset} holds no episodes (ep_NNNNNN); give the directory that `yamsim record` wrote")
    numbers = sorted(there)
    if episodes is not None:
        numbers = _selected(episodes, dataset, numbers)
    elif sample is not None and sample < len(numbers):
        step = (len(numbers) - 1) / max(1, sample - 1)
        numbers = [numbers[round(k * step)] for k in range(sample)]
    return [(number, there[number]) for number in numbers]


def _selected(text: str, dataset: Path, there: Sequence[int]) -> list[int]:
    chosen: set[int] = set()
    for part in text.split(","):
        match = _EPISODE_RANGE.match(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last:
            raise UsageError(
                f"--episodes {text!r}: {part.strip()!r} is neither a number nor a range; valid: {join_ranges(there)}"
            )
        # The range is compared with existing numbers: a list of the whole range may not fit into memory.
        named = [number for number in there if first <= number <= last]
        if len(named) != last - first + 1:
            missing = next(number for number in range(first, last + 1) if number not in set(named))
            raise UsageError(f"--episodes {text!r}: {dataset} has no episode {missing}; valid: {join_ranges(there)}")
        chosen.update(named)
    return sorted(chosen)


class RecordedImages:
    """An episode's images; `cameras` are the names of the cameras that have images."""

    def __init__(self, episode: RecordedEpisode) -> None:
        self._episode = episode
        self.cameras = tuple(episode.record.cameras)

    def read(self, camera: str, frame: int) -> Image:
        """An RGB image (height, width, 3); DatasetError if the file is missing, altered or damaged."""
        # Imported here: OpenCV takes 0.1 s to load, and most readers need no images.
        from ..images.jpeg import decode_jpeg

        image = decode_jpeg(self._episode.image(camera, frame))
        width, height = self._episode.record.cameras[camera]
        if image is None or image.shape[:2] != (height, width):
            raise DatasetError(f"{self._episode.directory}: frame {frame} of {camera} is no JPEG of {width}x{height}")
        return image


def recorded_images(episode: RecordedEpisode, cameras: Sequence[str]) -> Iterator[Image]:
    """Each frame's images, all cameras side by side; raises as `RecordedImages.read`."""
    images = RecordedImages(episode)
    for k in range(episode.record.frames):
        yield np.concatenate([images.read(camera, k) for camera in cameras], axis=1)
