"""Recordings of two arms and three cameras at 30 Hz, as stations of the maker's and of ABC's have them."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.export.real_datasets import bring_in
from tests.real.recordings.foreign import PROMPT
from tests.real.recordings.making import swinging
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_recorded_episode, read_side_by_side_images
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion

FPS = 30
CAMERAS = ("top_camera", "left_wrist_camera", "right_wrist_camera")
SIZE = (64, 48)  # px

# 0 to 255, mean difference between an image and the same after H.264, twice at most, and after JPEGs.
CODEC_ERROR = 4.0


def motion_at(rig: RigConfig, frames: int, fps: float = FPS) -> RecordedMotion:
    """A slow motion of `frames` samples."""
    made = swinging(rig, frames / 100)
    return RecordedMotion(made.name, np.arange(frames) / fps, made.arms)


def picture(camera: int, frame: int) -> NDArray[np.uint8]:
    """A smooth RGB image that tells camera and frame apart."""
    x, y = np.meshgrid(np.linspace(0, 1, SIZE[0]), np.linspace(0, 1, SIZE[1]))
    channels = [60 + 60 * x + 30 * camera, 40 + 80 * y, np.full_like(x, 30 + 2 * (frame % 100))]
    return np.stack(channels, axis=-1).astype(np.uint8)


def write_station_recording(
    folder: Path, motion: RecordedMotion, cameras: Sequence[str] = CAMERAS, prompt: str = PROMPT
) -> Path:
    """As the lab writes recordings: a pickle and images for each frame, grippers in metres."""
    (folder / "lowdim").mkdir(parents=True)
    for name in cameras:
        (folder / "rgb" / name).mkdir(parents=True)
    for k, time in enumerate(motion.times):
        rows = {"joints": [], "action_joints": []}  # type: dict[str, list[float]]
        for arm in motion.arms:
            assert arm.openings is not None and arm.commands is not None and arm.commanded_openings is not None
            rows["joints"] += [*arm.joints[k], arm.openings[k]]
            rows["action_joints"] += [*arm.commands[k], arm.commanded_openings[k]]
        frame = {key: np.array(row) for key, row in rows.items()}
        text = {"timestamp": float(time), "language_prompt": prompt}
        (folder / f"lowdim/{k:06d}.pkl").write_bytes(pickle.dumps(frame | text))
    for (number, name), k in itertools.product(enumerate(cameras), range(len(motion.times))):
        data = cv2.imencode(".jpg", picture(number, k)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        (folder / f"rgb/{name}/{k:06d}.jpg").write_bytes(data.tobytes())
    return folder


def station_dataset(
    folder: Path, motions: Sequence[RecordedMotion], rig: RigConfig, locations: Locations, prompt: str = PROMPT
) -> Path:
    """An imported dataset of such recordings."""
    made = [write_station_recording(folder / f"log{k}", motion, prompt=prompt) for k, motion in enumerate(motions)]
    return bring_in(folder / "real", made, rig, locations)


def images_of(dataset: Path, number: int, camera: str) -> NDArray[np.uint8]:
    """Images (n, height, width, 3) of an episode."""
    episode = open_recorded_episode(dataset / f"ep_{number:06d}")
    return np.stack(list(read_side_by_side_images(episode, (camera,))))


def image_error(found: NDArray[np.uint8], wanted: NDArray[np.uint8]) -> float:
    """Largest mean difference of two series of images of one shape, 0 to 255."""
    assert found.shape == wanted.shape
    return float(np.abs(found.astype(np.int16) - wanted).mean(axis=(1, 2, 3)).max())
