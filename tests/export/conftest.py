"""Datasets to export: a few episodes in real physics, with pictures by a formula."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.unrendered import SIZE, frame_count, write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations

EPISODES = 3
CAMERAS = ("scene_camera", "right_wrist_camera")


def picture(camera: str, episode: int, frame: int) -> NDArray[np.uint8]:
    """A smooth RGB picture (height, width, 3) that differs from frame to frame."""
    x, y = np.meshgrid(np.linspace(0, 1, SIZE[0]), np.linspace(0, 1, SIZE[1]))
    base = 90 + 30 * x + 20 * (camera == "scene_camera") + 60 * (camera == "left_wrist_camera")
    channels = [base, 60 + 30 * y + 20 * episode, np.full_like(x, 20 + 37 * frame % 200)]
    return np.stack(channels, axis=-1).clip(0, 255).astype(np.uint8)


def frames_of(dataset: Path) -> list[int]:
    """Number of frames of each episode."""
    return [frame_count(dataset / f"ep_{k:06d}") for k in range(EPISODES)]


def ignore(done: int, total: int) -> None:
    """Ignore progress."""


def jpeg(camera: str, episode: int, frame: int) -> bytes:
    return cv2.imencode(".jpg", picture(camera, episode, frame)[..., ::-1])[1].tobytes()


def depth(camera: str, episode: int, frame: int) -> dict[str, bytes]:
    """Depth of the scene camera alone."""
    if camera != "scene_camera":
        return {}
    stream = io.BytesIO()
    np.savez_compressed(stream, depth=np.full((SIZE[1], SIZE[0]), 700 + frame, np.uint16))
    return {f"depth/{camera}/{frame:06d}.npz": stream.getvalue()}


@pytest.fixture(scope="session")
def dataset(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    path = tmp_path_factory.mktemp("exports") / "dataset"
    write_dataset(path, make_config({("wrist",): True}), locations, EPISODES, jpeg)
    return path


@pytest.fixture(scope="session")
def dataset_with_depth(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    path = tmp_path_factory.mktemp("exports") / "dataset_with_depth"
    write_dataset(path, make_config(), locations, 1, jpeg, depth)
    return path


@pytest.fixture(scope="session")
def two_armed(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    """One handover, with both wrist cameras."""
    path = tmp_path_factory.mktemp("exports") / "two_armed"
    config = make_config({("rig",): "russet", ("task",): "handover", ("wrist",): True})
    write_dataset(path, config, locations, 1, jpeg)
    return path
