"""The files of raiden's layout beside the pictures, for simulated and for real episodes."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dataset.lowdim import dump_frame
from ..dataset.reader import RecordedEpisode
from . import raiden_schema as schema
from .raiden_frames import hand_frame
from .raiden_options import RaidenOptions


def metadata(
    episode: RecordedEpisode,
    names: Mapping[str, str],
    data: Sequence[Mapping[str, Any]],
    options: RaidenOptions,
    *,
    framerate: float,
    control: str,
    pictures: Mapping[str, Any],
    depth: bool = False,
) -> dict[str, Any]:
    """The content of `metadata.json`.

    Args:
        names: camera -> its name in raiden's layout.
        data: the episode's converted frames.
        framerate: frames a second.
        control: how the arm was driven.
        pictures: where they come from.
        depth: whether there are depth images.
    """
    sizes = {names[camera]: [height, width] for camera, (width, height) in episode.record.cameras.items()}
    one_size = len({tuple(size) for size in sizes.values()}) == 1
    task = str(data[0]["language_task"])
    return {
        "info": {
            "name": task,
            "raw_id": f"{episode.dataset.name}/{episode.directory.name}",
            "tags": ["robotics"],
        },
        "labels": [*(["rgb"] if sizes else []), *(["depth"] if depth else []), "action", "language"],
        "cameras": list(sizes),
        "resolution": next(iter(sizes.values())) if one_size else sizes,
        "framerate": _plain(framerate),
        "language": {"task": task, "prompt": [str(data[0]["language_prompt"])]},
        "num_frames": len(data),
        "rgb": {"extension": options.images},
        **({"depth": {"extension": "npz", "sparse": False, "metric": True}} if depth else {}),
        "intrinsics": {"model": "pinhole"},
        "extrinsics": {"transform": "cam2world", "metric": True},
        "action": {"format": "joint_cmd", "dims": len(data[0]["action_joints"])},
        "control": control,
        "hand_frame": hand_frame(options.hand_frame),
        "pictures": dict(pictures),
    }


def _plain(number: float) -> float:
    """The number itself, as an int if it is whole."""
    return int(number) if number.is_integer() else number


def write_episode(
    folder: Path, times: Sequence[float], data: Sequence[Mapping[str, Any]], metadata: Mapping[str, Any]
) -> None:
    """Write all of an episode except its pictures: frames, capture times (s), and metadata."""
    nanoseconds = _npy(np.array([round(time * 1e9) for time in times], dtype=schema.TIMESTAMPS.dtype))
    for camera in metadata["cameras"]:
        (folder / "rgb" / camera / schema.TIMESTAMPS_FILE).write_bytes(nanoseconds)
    (folder / "lowdim").mkdir(parents=True)
    for k, frame in enumerate(data):
        (folder / "lowdim" / schema.frame_name(k, "pkl")).write_bytes(dump_frame(frame))
    write_json(folder / schema.METADATA, metadata)


def write_split(root: Path, frames: Mapping[str, int]) -> None:
    """Write the file that tells how many frames each episode has."""
    size = {"n_seqs": len(frames), "n_samples": len(frames), "n_frames": sum(frames.values())}
    write_json(root / schema.SPLIT, {"filters": {}, "size": size, "files": dict(sorted(frames.items()))})


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file of the layout."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")


def _npy(array: NDArray[np.int64]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()
