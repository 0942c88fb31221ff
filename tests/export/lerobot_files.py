"""Content of a LeRobot dataset, file by file, and of the recording, for comparison."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.images.jpeg import decode_jpeg

# Frames of one episode, as recorded.
Frames = list[dict[str, Any]]


def rows(root: Path, pattern: str) -> dict[str, list[Any]]:
    """Return the columns of a series of Parquet files, as lists."""
    import pyarrow.parquet as parquet

    tables = [parquet.read_table(file).to_pydict() for file in sorted(root.glob(pattern))]
    return {key: [value for table in tables for value in table[key]] for key in tables[0]}


def recorded(dataset: Path) -> list[Frames]:
    """Return the content of a dataset's episodes."""
    folders = sorted(dataset.glob("ep_*/lowdim"))
    return [[load_frame(file.read_bytes()) for file in sorted(folder.iterdir())] for folder in folders]


def jpegs(dataset: Path, camera: str) -> np.ndarray:
    """Return all pictures of a camera, (frames, height, width, 3)."""
    files = [file for folder in sorted(dataset.glob(f"ep_*/rgb/{camera}")) for file in sorted(folder.iterdir())]
    return np.array([decode_jpeg(file.read_bytes()) for file in files])


def check_numbers(found: Mapping[str, Any], episodes: Sequence[Frames], cameras: Iterable[str]) -> None:
    """Assert that an export of these episodes, in this order, has all recorded numbers, in single precision."""
    frames = [frame for episode in episodes for frame in episode]

    def same(key: str, wanted: Any) -> None:
        np.testing.assert_array_equal(np.asarray(found[key], np.float32), np.asarray(wanted, np.float32), err_msg=key)

    same("observation.state", [frame["joints"] for frame in frames])
    same("action", [[*frame["ctrl"], *np.atleast_1d(frame["magnet"]).astype(float)] for frame in frames])
    for camera in cameras:
        for what, size in (("intrinsics", 9), ("extrinsics", 16)):
            key = f"camera.{what}.{camera}"
            if key in found:
                same(key, [np.reshape(frame[what][camera], size) for frame in frames])
    same("timestamp", [frame["timestamp"] for frame in frames])
    same("frame_index", [k for episode in episodes for k in range(len(episode))])
    same("episode_index", [number for number, episode in enumerate(episodes) for _ in episode])
    same("index", range(len(frames)))
    same("task_index", [0] * len(frames))
