"""Decoded frames of a dataset in memory-mapped files, so that training decodes each JPEG once."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.dataset.dataset_paths import EPISODE_FILE
from yamsim_cli.core.dataset.disk_errors import explain_disk_error
from yamsim_cli.core.dataset.reader import StoredEpisode, StoredEpisodes
from yamsim_cli.core.errors import DatasetError, ResourceError, UsageError
from yamsim_cli.core.files.writing import sha256_bytes, staged_directory

_FORMAT = 1  # of a cache; caches of another format are made again
_NAME_CHARACTERS = 16  # of the hash in a cache's name: no two of a user's datasets share 64 bits


@dataclass(frozen=True)
class DecodedFrames:
    """Arrays of all frames of a dataset, one episode after the other, in files.

    A pickle holds only the folder, so processes share the pages of the files.

    Attributes:
        folder: has `KEY.npy` for each key.
        keys: names of arrays.
        lengths: frames of each episode.
    """

    folder: Path
    keys: tuple[str, ...]
    lengths: tuple[int, ...]

    @functools.cached_property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Key -> memory-mapped, read-only array (frames, ...)."""
        return {key: np.load(self.folder / f"{key}.npy", mmap_mode="r", allow_pickle=False) for key in self.keys}

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder, "keys": self.keys, "lengths": self.lengths}


def open_decoded_frames(
    episodes: StoredEpisodes, cameras: Sequence[str], keys: Sequence[str], cache: Path | None = None
) -> DecodedFrames:
    """Return the decoded frames of episodes, from the cache if they are there. Otherwise, decode them into the cache.

    The name of a cached set has a hash of the episodes, cameras and keys, so a changed dataset is decoded again.
    Several processes may call the function at the same time.

    Args:
        cameras: recorded cameras, whose images become arrays (frames, height, width, 3), uint8, RGB.
        keys: keys of frames, such as "joints".
        cache: folder of cached sets; by default `DATASET_decoded` beside the dataset.

    Raises:
        UsageError: there are no episodes.
        DatasetError: a file is missing, altered or damaged, or episodes differ in keys or image sizes.
        ResourceError: the cache cannot be written.
    """
    opened = list(episodes)
    if not opened:
        raise UsageError(f"{episodes.path} has no episodes to train on")
    path = episodes.path.absolute()
    folder = (cache or path.with_name(f"{path.name}_decoded")) / _hash_content(opened, cameras, keys)
    names = (*keys, *cameras)
    lengths = tuple(episode.record.frames for episode in opened)
    if not folder.is_dir():
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            with staged_directory(folder) as stage:
                _decode(opened, cameras, keys, stage.path)
        except OSError as error:
            if isinstance(error, FileExistsError) and folder.is_dir():
                return DecodedFrames(folder, names, lengths)  # another process has finished first
            reason = explain_disk_error(error, folder.parent)
            raise ResourceError(f"{reason}: the decoded frames were not stored; give another cache") from error
    return DecodedFrames(folder, names, lengths)


def _hash_content(episodes: Sequence[StoredEpisode], cameras: Sequence[str], keys: Sequence[str]) -> str:
    # `episode.json` has the hashes of all files of its episode.
    content = [
        [sha256_bytes(episode.read(EPISODE_FILE)), episode.first_frame, episode.record.frames] for episode in episodes
    ]
    text = json.dumps([_FORMAT, list(cameras), list(keys), content])
    return sha256_bytes(text.encode())[:_NAME_CHARACTERS]


def _decode(episodes: Sequence[StoredEpisode], cameras: Sequence[str], keys: Sequence[str], folder: Path) -> None:
    total = sum(episode.record.frames for episode in episodes)
    files: dict[str, NDArray[Any]] = {}
    first = 0
    for episode in episodes:
        found = episode.arrays(cameras)
        last = first + episode.record.frames
        for name in (*keys, *cameras):
            if name not in found:
                numbers = ", ".join(key for key in found if key not in cameras)
                raise DatasetError(f"{episode.directory}: frames have no {name!r}; valid: {numbers}")
            rows = found[name]
            if name not in files:
                files[name] = np.lib.format.open_memmap(
                    folder / f"{name}.npy", mode="w+", dtype=rows.dtype, shape=(total, *rows.shape[1:])
                )
            if rows.shape[1:] != files[name].shape[1:]:
                raise DatasetError(
                    f"{episode.directory}: {name} has the shape {rows.shape[1:]}, and {files[name].shape[1:]} in "
                    f"{episodes[0].directory.name}; train on episodes of equal shapes"
                )
            files[name][first:last] = rows
        first = last
