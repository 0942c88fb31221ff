"""A real dataset without rendering: each image is the same small grey one."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.attempts import planned
from yamsim_cli.core.attempt_data import AttemptPayload
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.dataset_paths import CONFIG_FILE, EPISODE_FILE, episode_name, image_path, lowdim_path
from yamsim_cli.core.dataset.lowdim import content_hash, dump_frame, load_frame
from yamsim_cli.core.dataset.records import to_json
from yamsim_cli.core.episode.attempt_payload import frame_records, library_versions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.recording.collect import episode_record

SIZE = (24, 16)


def grey(camera: str, episode: int, frame: int) -> bytes:
    """Return the same image for any frame."""
    return cv2.imencode(".jpg", np.full((SIZE[1], SIZE[0], 3), 128, np.uint8))[1].tobytes()


def write_dataset(
    path: Path,
    config: RecordConfig,
    locations: Locations,
    episodes: int,
    image: Callable[[str, int, int], bytes] = grey,
    others: Callable[[str, int, int], dict[str, bytes]] = lambda camera, episode, frame: {},
) -> None:
    """Write the episodes that `yamsim record` would make if no attempt failed. `image` gives the JPEG of a camera's
    frame, `others` further files.
    """
    path.mkdir()
    (path / CONFIG_FILE).write_text(dump_yaml(config.data_config()))
    with Simulator(Session(config, locations)) as simulator:
        for number in range(episodes):
            done = planned(simulator, config.seed, number)
            assert done.outcome.success
            made = frame_records(simulator, done.attempt, done.recorded_states)
            files = {lowdim_path(k): dump_frame(frame) for k, frame in enumerate(made)}
            cameras = simulator.scene.cameras
            for camera, k in itertools.product(cameras, range(len(made))):
                files |= {image_path(camera, k): image(camera, number, k)} | others(camera, number, k)
            payload = AttemptPayload(
                done.attempt, done.outcome, files, len(made), content_hash(made), library_versions(), "none"
            )
            record = episode_record(config, payload, number).model_copy(
                update={"cameras": dict.fromkeys(cameras, SIZE)}
            )
            for name, data in files.items():
                (path / episode_name(number) / name).parent.mkdir(parents=True, exist_ok=True)
                (path / episode_name(number) / name).write_bytes(data)
            (path / episode_name(number) / EPISODE_FILE).write_bytes(to_json(record))


def change_record(directory: Path, **changes: Any) -> None:
    """Write other values into an episode's record."""
    record = json.loads((directory / EPISODE_FILE).read_text())
    (directory / EPISODE_FILE).write_text(json.dumps(record | changes))


def change_frame(directory: Path, number: int, *, rehash: bool, **changes: Any) -> None:
    """Write other values into one frame; None removes a key. `rehash` updates the hashes."""
    name = lowdim_path(number)
    frame = read_frame(directory, number) | changes
    data = dump_frame({key: value for key, value in frame.items() if value is not None})
    (directory / name).write_bytes(data)
    if rehash:
        files = json.loads((directory / EPISODE_FILE).read_text())["files"]
        change_record(directory, files=files | {name: sha256_bytes(data)})


def frame_count(directory: Path) -> int:
    """Number of frames in an episode's record."""
    return int(json.loads((directory / EPISODE_FILE).read_text())["frames"])


def read_frame(directory: Path, number: int) -> dict[str, Any]:
    """One frame of an episode."""
    return load_frame((directory / lowdim_path(number)).read_bytes())
