"""Windows of demonstrations for policies that answer with action chunks, as a map-style dataset of PyTorch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yamsim_cli.core.dataset.reader import StoredEpisodes
from yamsim_cli.core.errors import UsageError

from .decoded_frames import open_decoded_frames

_ACTION_KEYS = ("ctrl", "magnet")  # of a frame: what the policy has to answer


class ChunkWindows:
    """Each recorded frame with the chunk of actions that begins at it.

    `windows[k]` is the window at frame k of the dataset, and `windows[[3, 8]]` a batch. A window is a dict:

    - camera -> image (height, width, 3), uint8, RGB
    - key of a frame, such as "joints" (drives,) -> its value
    - "action" (chunk, drives + arms), float32: `ctrl`, rad and m, and then `magnet`, 0 or 1, of each frame from k on
    - "is_padding" (chunk,), bool: whether the episode has ended before that action. Its row repeats the last action

    A batch has a first axis for the windows. `torch.utils.data.DataLoader` takes the object directly; PyTorch is not
    needed otherwise. The images are decoded once, into a cache of memory-mapped files, which all processes share.

    Attributes:
        chunk: number of actions.
        arrays: key or camera -> the values of all frames (frames, ...), and "action" (frames, drives + arms).
        episode_index: number of each frame's episode in the sequence (frames,).

    Args:
        episodes: result of `open_dataset`, or a slice of it.
        cameras: recorded cameras.
        keys: keys of frames that are part of the observation.
        cache: folder for decoded frames; by default `DATASET_decoded` beside the dataset.
    """

    def __init__(
        self,
        episodes: StoredEpisodes,
        cameras: Sequence[str] = (),
        *,
        chunk: int = 32,
        keys: Sequence[str] = ("joints",),
        cache: str | Path | None = None,
    ) -> None:
        if chunk < 1:
            raise UsageError(f"chunk={chunk} is not valid: give the number of actions of a chunk, at least 1")
        stored = tuple(dict.fromkeys((*keys, *_ACTION_KEYS)))
        self._frames = open_decoded_frames(episodes, cameras, stored, None if cache is None else Path(cache))
        self._names, self.chunk = (*keys, *cameras), chunk
        lengths = self._frames.lengths
        self.episode_index = np.repeat(np.arange(len(lengths)), lengths)
        self._last = (np.cumsum(lengths) - 1)[self.episode_index]
        ctrl, magnet = (self._frames.arrays[key] for key in _ACTION_KEYS)
        self._action = np.concatenate([ctrl, magnet.reshape(len(magnet), -1)], axis=1, dtype=np.float32)

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Key or camera -> values of all frames (frames, ...), memory-mapped; and "action" (frames, drives + arms)."""
        return {name: self._frames.arrays[name] for name in self._names} | {"action": self._action}

    def __len__(self) -> int:
        return len(self._last)

    def __getitem__(self, index: SupportsIndex | ArrayLike) -> dict[str, NDArray[Any]]:
        """Return the window at a frame, or a batch of windows. Raise IndexError for a frame that does not exist."""
        rows = np.asarray(index)
        if rows.size and not (-len(self) <= rows.min() and rows.max() < len(self)):
            raise IndexError(f"window {index!r} is not one of {len(self)}")
        rows = rows % len(self)
        last = self._last[rows][..., None]
        steps = rows[..., None] + np.arange(self.chunk)
        # np.array copies: arrays of PyTorch must be writable.
        seen = {name: np.array(self._frames.arrays[name][rows]) for name in self._names}
        return seen | {"action": self._action[np.minimum(steps, last)], "is_padding": steps > last}
