"""An episode's images, decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..errors import DatasetError
from ..images.image import Image
from ..images.jpeg import decode_jpeg
from .reader import RecordedEpisode


class RecordedImages:
    """An episode's images as they were recorded.

    Attributes:
        cameras: names of the cameras that have images.
    """

    def __init__(self, episode: RecordedEpisode) -> None:
        self._episode = episode
        self.cameras = tuple(episode.record.cameras)

    def read(self, camera: str, frame: int) -> Image:
        """An RGB image (height, width, 3).

        Raises:
            DatasetError: it is missing, altered or damaged.
        """
        image = decode_jpeg(self._episode.image(camera, frame))
        width, height = self._episode.record.cameras[camera]
        if image is None or image.shape[:2] != (height, width):
            raise DatasetError(f"{self._episode.directory}: frame {frame} of {camera} is no JPEG of {width}x{height}")
        return image


def recorded_images(episode: RecordedEpisode, cameras: Sequence[str]) -> Iterator[Image]:
    """Each frame's images, those of all cameras side by side; raises as `RecordedImages.read`."""
    images = RecordedImages(episode)
    for k in range(episode.record.frames):
        yield np.concatenate([images.read(camera, k) for camera in cameras], axis=1)
