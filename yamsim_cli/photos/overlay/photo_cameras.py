"""Determine a photo's camera: calibration file, recording, or estimate from boards."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError, ResourceError
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.image_files import read_image, to_grey

from ..fiducials.focal_length.focal_estimate import FocalEstimate, estimate_focal, find_outlines, known_focal
from .photos import Photo

_MAX_SEARCHED_PHOTOS = 40  # to estimate a focal length
_SUFFICIENT_PHOTOS = 8  # photos with a board that end the search


@dataclass(frozen=True)
class PhotoCamera:
    """A camera and its `source`: "file" (calibration), "episode" (recording) or "estimated" (from boards)."""

    focal: FocalEstimate
    source: str

    @classmethod
    def from_calibration(cls, camera: CameraModel, source: str) -> PhotoCamera:
        """Wrap a calibrated camera with source "file" or "episode"."""
        return cls(known_focal(camera), source)

    @property
    def camera(self) -> CameraModel:
        """The camera model; an uncalibrated one has the estimated focal length."""
        return self.focal.camera


class PhotoCameras:
    """Determines cameras; photos of one size from an unknown camera share an estimate from `paths`.

    `camera` is the calibration of all photos; None for the recorded camera or an estimate.
    """

    def __init__(self, rig: RigConfig, paths: Sequence[Path], camera: CameraModel | None) -> None:
        self._rig, self._paths, self._camera = rig, paths, camera
        self._estimated: dict[tuple[int, ...], PhotoCamera] = {}

    def camera_of(self, photo: Photo, image: Image) -> PhotoCamera:
        """Return the camera of a photo with RGB image (height, width, 3).

        Raises:
            ConfigError: the camera is calibrated for another image size.
        """
        height, width = image.shape[:2]
        if camera := self._camera:
            if (camera.width, camera.height) != (width, height):
                raise ConfigError(
                    f"{photo.path} has {width} x {height} pixels, but the camera is calibrated for {camera.width} x "
                    f"{camera.height}: give the camera file of this image size"
                )
            return PhotoCamera.from_calibration(camera, "file")
        if photo.camera:
            return PhotoCamera.from_calibration(photo.camera, "episode")
        if image.shape not in self._estimated:
            self._estimated[image.shape] = estimate_camera(
                self._images_of_shape(image.shape), (height, width), self._rig
            )
        return self._estimated[image.shape]

    def _images_of_shape(self, shape: tuple[int, ...]) -> Iterator[Image]:
        for path in self._paths:
            try:
                image = read_image(path)
            except ResourceError:
                continue
            if image.shape == shape:
                yield image


def estimate_camera(images: Iterable[Image], size: tuple[int, int], rig: RigConfig) -> PhotoCamera:
    """Estimate an unknown camera from boards in its RGB images, all of `size` (height, width), px."""
    boards = [arm.board.board_in_metres for arm in rig.arms if arm.board]
    outlines, with_board = [], 0
    for image in itertools.islice(images, _MAX_SEARCHED_PHOTOS):
        found = find_outlines(to_grey(image), boards)
        outlines += found
        with_board += bool(found)
        if with_board == _SUFFICIENT_PHOTOS:
            break
    height, width = size
    return PhotoCamera(estimate_focal(outlines, (width, height)), "estimated")
