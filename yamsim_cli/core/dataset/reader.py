"""Find, select and read published episodes, whose files are not trusted."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self, SupportsIndex, overload

import numpy as np
from numpy.typing import NDArray

from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..errors import DatasetError, UsageError, count_noun, join_ranges
from ..files.resources import Locations
from ..files.writing import sha256_bytes
from ..images.image import Image
from .checks.context import find_episodes
from .checks.lowdim import frame_faults, recorded_specs
from .dataset_paths import CONFIG_FILE, EPISODE_FILE, episode_directories, episode_name, image_path, lowdim_path
from .imported_records import RealEpisodeRecord, is_imported_dataset, read_dataset_config, read_imported_config
from .lowdim import load_frame
from .records import EpisodeRecord, from_json

_REAL_SOURCE = re.compile(rb'"source"\s*:\s*"real"')  # matches the `episode.json` of an imported recording
_EPISODE_RANGE = re.compile(r"^(?:ep_)?(\d+)(?:-(?:ep_)?(\d+))?$")


@dataclass(frozen=True)
class RecordedEpisode:
    """A simulated or real episode on disk: its directory and the content of its `episode.json`.

    `first_frame` is the recorded frame that `frames` and `image` count as frame 0; above 0 only after `trimmed`.
    """

    directory: Path
    record: EpisodeRecord | RealEpisodeRecord
    first_frame: int = field(default=0, kw_only=True)

    def trimmed(self, first: int, last: int) -> Self:
        """Return the episode with only its recorded frames `first` to `last`. Their timestamps do not change."""
        record = self.record.model_copy(update={"frames": last - first + 1})
        return replace(self, record=record, first_frame=first)

    @property
    def dataset_directory(self) -> Path:
        """The dataset's directory."""
        return self.directory.absolute().parent

    def read(self, name: str) -> bytes:
        """Return the content of a file without a hash check. Raise DatasetError if the file is unreadable."""
        try:
            return (self.directory / name).read_bytes()
        except OSError as error:
            raise DatasetError(f"{self.directory / name} cannot be read: {error.strerror or error}") from error

    def is_altered(self, name: str, data: bytes) -> bool:
        """Return whether the SHA-256 of a file's content differs from the recorded hash."""
        return sha256_bytes(data) != self.record.files.get(name)

    def read_verified(self, name: str) -> bytes:
        """Return the content of a file. Raise DatasetError if it is unreadable or differs from its recorded hash."""
        data = self.read(name)
        if self.is_altered(name, data):
            raise DatasetError(
                f"{self.directory / name} is not what was recorded: its sha256 is not the one in {EPISODE_FILE}; "
                "copy the episode again, or record it again"
            )
        return data

    def decode_frame_data(self, number: int, data: bytes) -> dict[str, Any]:
        """Decode the low-dimensional data of one frame from its file content. Raise DatasetError if it is damaged."""
        try:
            return load_frame(data)
        except DatasetError as error:
            raise DatasetError(f"{self.directory / lowdim_path(number)}: {error}") from error

    def frames(self) -> list[dict[str, Any]]:
        """Read the low-dimensional data of all frames. Raise DatasetError if a file is missing, damaged or altered."""
        first = self.first_frame
        return [
            self.decode_frame_data(k, self.read_verified(lowdim_path(k)))
            for k in range(first, first + self.record.frames)
        ]

    def image(self, camera: str, number: int) -> bytes:
        """Return the JPEG bytes of a frame. Raise DatasetError if the file is missing or altered."""
        return self.read_verified(image_path(camera, self.first_frame + number))

    def arrays(self, cameras: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
        """Return key -> numbers of all frames (frames, ...), and camera -> its RGB images (frames, height, width, 3).

        Texts, cameras' matrices and keys of the simulation are left out. Raise DatasetError as `frames` and `image` do.
        """
        frames, images = self.frames(), RecordedImages(self)
        kept = [key for key, value in frames[0].items() if not isinstance(value, str | dict) and key[:4] != "sim_"]
        pictures = {camera: np.stack([images.read_image(camera, k) for k in range(len(frames))]) for camera in cameras}
        return {key: np.array([frame[key] for frame in frames]) for key in kept} | pictures


@dataclass(frozen=True)
class StoredEpisode(RecordedEpisode):
    """A simulated episode on disk."""

    record: EpisodeRecord

    def decode_frame_data(self, number: int, data: bytes) -> dict[str, Any]:
        """Decode the low-dimensional data of one frame. Raise DatasetError if it does not fit the record."""
        frame = super().decode_frame_data(number, data)
        faults = frame_faults(frame, recorded_specs(self.record))
        if faults:
            raise DatasetError(f"{self.directory / lowdim_path(number)}: {'; '.join(faults)}")
        return frame


def open_episode(directory: Path) -> StoredEpisode:
    """Open a simulated episode. Raise DatasetError if it is missing, damaged, or a recording of real arms."""
    episode = open_recorded_episode(directory)
    if not isinstance(episode, StoredEpisode):
        raise DatasetError(f"{directory} is an imported recording of real arms; give a simulated episode")
    return episode


def open_recorded_episode(directory: Path) -> RecordedEpisode:
    """Open a simulated or real episode. Raise DatasetError if the directory has no episode or a damaged record."""
    file = directory / EPISODE_FILE
    try:
        text = file.read_bytes()
    except OSError as error:
        raise DatasetError(
            f"{directory} is not an episode: {EPISODE_FILE} cannot be read ({error.strerror or error}); "
            "give a directory such as dataset/ep_000003"
        ) from error
    if _REAL_SOURCE.search(text):
        return RecordedEpisode(directory, from_json(RealEpisodeRecord, text, file))
    return StoredEpisode(directory, from_json(EpisodeRecord, text, file))


def open_all_episodes(dataset: Path) -> list[RecordedEpisode]:
    """Open all episodes of a dataset that yamsim wrote. Raise DatasetError if it is none, or a record is damaged."""
    found, recorded = find_episodes(dataset)
    if not recorded and not is_imported_dataset(dataset):
        raise _not_recorded_error(dataset)
    return [open_recorded_episode(episode.path) for episode in found]


class StoredEpisodes(Sequence[StoredEpisode]):
    """Sequence of a dataset's episodes. Each access reads the episode from disk. `path` is the dataset directory."""

    def __init__(
        self, path: Path, directories: Sequence[Path], opener: Callable[[Path], StoredEpisode] | None = None
    ) -> None:
        """`opener` opens the episode in a directory; by default `open_episode`."""
        self.path = path
        self._directories = tuple(directories)
        self._open = opener or open_episode

    def __len__(self) -> int:
        return len(self._directories)

    @overload
    def __getitem__(self, key: SupportsIndex) -> StoredEpisode: ...

    @overload
    def __getitem__(self, key: slice) -> StoredEpisodes: ...

    def __getitem__(self, key: SupportsIndex | slice) -> StoredEpisode | StoredEpisodes:
        """Return an episode or a slice. Raises IndexError, or DatasetError if a record is missing or damaged."""
        if isinstance(key, slice):
            return StoredEpisodes(self.path, self._directories[key], self._open)
        try:
            directory = self._directories[key]
        except IndexError:
            raise IndexError(f"{self.path} has {count_noun(len(self), 'episode')}, but none at index {key}") from None
        return self._open(directory)

    def arrays(self, cameras: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
        """Return the `arrays` of all episodes in a row, of keys that all have, and `episode_index` (frames,)."""
        each = [one.arrays(cameras) | {"episode_index": np.full(one.record.frames, k)} for k, one in enumerate(self)]
        shared = [key for key in each[0] if all(key in one for one in each)] if each else []
        return {key: np.concatenate([one[key] for one in each]) for key in shared}

    def __repr__(self) -> str:
        return f"<{count_noun(len(self), 'episode')} of {self.path}>"


def open_episodes(dataset: Path) -> StoredEpisodes:
    """Return the episodes of a dataset. Raise DatasetError if yamsim did not record a dataset there."""
    found, recorded = find_episodes(dataset)
    if not recorded:
        raise _not_recorded_error(dataset)
    return StoredEpisodes(dataset, [episode.path for episode in found])


def _not_recorded_error(dataset: Path) -> DatasetError:
    return DatasetError(
        f"{dataset} is a plain recording, without {CONFIG_FILE} and {EPISODE_FILE}: `yamsim summarize` can check it, "
        "but its "
        "episodes cannot be opened; give the directory that `yamsim record` wrote, or import it with `yamsim import`"
    )


def find_episode(path: Path, number: int | None) -> RecordedEpisode:
    """Open the episode at a path: an episode directory, or a dataset directory with an episode number.

    Raises:
        UsageError: the path is a dataset, and `number` is None or names no episode of it.
        DatasetError: the path holds no episode, or the record is damaged.
    """
    there = episode_directories(path) if path.is_dir() else []
    if number is None and not there:
        return open_recorded_episode(path)
    names = ", ".join(directory.name for _, directory in there[:3]) + (", ..." if len(there) > 3 else "")
    if number is None:
        raise UsageError(f"{path} is a dataset: give one of its episodes ({names}), or --episode")
    if number not in dict(there):
        raise UsageError(f"--episode {number}: there is no {episode_name(number)} in {path}; it has {names or 'none'}")
    return open_recorded_episode(dict(there)[number])


def read_recording_config(dataset: Path, locations: Locations) -> RecordConfig:
    """Return the configuration that a dataset was recorded with. Raise DatasetError if it is missing or invalid."""
    if is_imported_dataset(dataset):
        raise DatasetError(
            f"{dataset} holds real recordings, which were not simulated and cannot be made again; "
            f"`yamsim summarize {dataset} --strict` checks the hash of every file, and `yamsim gap {dataset}` compares "
            "them with the simulation"
        )
    return read_dataset_config(RecordConfig, dataset, locations)


def read_recorded_rig(dataset: Path, locations: Locations) -> RigConfig:
    """Return the rig (arms and cameras) of a dataset. Raise DatasetError if the config is missing or invalid."""
    return (
        read_imported_config(dataset, locations).rig
        if is_imported_dataset(dataset)
        else read_recording_config(dataset, locations).rig
    )


def select_episode_directories(
    dataset: Path, episodes: str | None, sample: int | None, among: Collection[int] | None = None
) -> list[tuple[int, Path]]:
    """Return the number and directory of the selected episodes, in order.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.
        sample: number of episodes to select, evenly spread; None for all. Ignored if `episodes` is given.
        among: numbers of the episodes that may be selected; None for all.

    Raises:
        DatasetError: `dataset` is not a directory with episodes.
        UsageError: an episode does not exist, or `episodes` is not a list of numbers and ranges.
    """
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} is not a directory; give the directory that `yamsim record` wrote")
    there = dict(episode_directories(dataset))
    if not there:
        raise DatasetError(f"{dataset} holds no episodes (ep_NNNNNN); give the directory that `yamsim record` wrote")
    numbers = sorted(there)
    if episodes is not None:
        numbers = _parse_selection(episodes, dataset, numbers)
    if among is not None:
        numbers = [number for number in numbers if number in among]
    if episodes is None and sample is not None and sample < len(numbers):
        step = (len(numbers) - 1) / max(1, sample - 1)
        numbers = [numbers[round(k * step)] for k in range(sample)]
    return [(number, there[number]) for number in numbers]


def _parse_selection(text: str, dataset: Path, available: Sequence[int]) -> list[int]:
    chosen: set[int] = set()
    for part in text.split(","):
        match = _EPISODE_RANGE.match(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last:
            raise UsageError(
                f"--episodes {text!r}: {part.strip()!r} is neither a number nor a range; "
                f"valid: {join_ranges(available)}"
            )
        # Filter the existing numbers by the range: a list of the whole range may not fit into memory.
        named = [number for number in available if first <= number <= last]
        if len(named) != last - first + 1:
            missing = next(number for number in range(first, last + 1) if number not in set(named))
            raise UsageError(
                f"--episodes {text!r}: {dataset} has no episode {missing}; valid: {join_ranges(available)}"
            )
        chosen.update(named)
    return sorted(chosen)


class RecordedImages:
    """Reads the images of an episode. `cameras` holds the names of the cameras that have images."""

    def __init__(self, episode: RecordedEpisode) -> None:
        self._episode = episode
        self.cameras = tuple(episode.record.cameras)

    def read_image(self, camera: str, frame: int) -> Image:
        """Return an RGB image (height, width, 3). Raise DatasetError if the file is missing, altered or damaged."""
        # Imported here because OpenCV takes 0.1 s to load and most readers need no images.
        from ..images.jpeg import decode_jpeg

        if camera not in self.cameras:
            raise DatasetError(f"{self._episode.directory}: no camera {camera!r}; valid: {', '.join(self.cameras)}")
        image = decode_jpeg(self._episode.image(camera, frame))
        width, height = self._episode.record.cameras[camera]
        if image is None or image.shape[:2] != (height, width):
            place = f"{self._episode.directory}: frame {frame} of {camera}"
            raise DatasetError(f"{place} is not a JPEG of {width}x{height}")
        return image


def read_side_by_side_images(episode: RecordedEpisode, cameras: Sequence[str]) -> Iterator[Image]:
    """Yield the images of each frame, with `cameras` side by side. Raise DatasetError for a missing or altered file."""
    images = RecordedImages(episode)
    for k in range(episode.record.frames):
        yield np.concatenate([images.read_image(camera, k) for camera in cameras], axis=1)
