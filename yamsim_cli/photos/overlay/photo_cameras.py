"""The camera that took a photo: from a calibration file, from a recording, or estimated from the boards."""

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

_PHOTOS_TO_SEARCH = 40  # photos at most in which boards are searched to estimate a focal length
_PHOTOS_FOR_FOCAL = 8  # photos with a board after which the search ends


@dataclass(frozen=True)
class PhotoCamera:
    """A camera's focal length and model, and where they come from: "file", "episode" or "estimated"."""

    focal: FocalEstimate
    source: str

    @classmethod
    def from_calibration(cls, camera: CameraModel, source: str) -> PhotoCamera:
        """The lens of a calibrated camera."""
        return cls(known_focal(camera), source)

    @property
    def camera(self) -> CameraModel:
        """The camera, with the estimated focal length if the camera is not calibrated."""
        return self.focal.camera


class PhotoCameras:
    """The lenses of photos. Photos of one size by an unknown camera share one estimate.

    Args:
        paths: all photos from which a focal length may be estimated.
        camera: the calibrated camera of all photos; None to take each photo's own, or else an estimate.
    """

    def __init__(self, rig: RigConfig, paths: Sequence[Path], camera: CameraModel | None) -> None:
        self._rig, self._paths, self._camera = rig, paths, camera
        self._estimated: dict[tuple[int, ...], PhotoCamera] = {}

    def camera_of(self, photo: Photo, image: Image) -> PhotoCamera:
        """The lens of a photo, whose RGB image is (height, width, 3).

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
            self._estimated[image.shape] = unknown_lens(self._images(image.shape), (height, width), self._rig)
        return self._estimated[image.shape]

    def _images(self, shape: tuple[int, ...]) -> Iterator[Image]:
        for path in self._paths:
            try:
                image = read_image(path)
            except ResourceError:
                continue
            if image.shape == shape:
                yield image


def unknown_lens(images: Iterable[Image], size: tuple[int, int], rig: RigConfig) -> PhotoCamera:
    """The lens of an unknown camera, estimated from the boards in its photos.

    Args:
        images: RGB, all of one size.
        size: their height and width, px.
    """
    boards = [arm.board.board for arm in rig.arms if arm.board]
    outlines, with_board = [], 0
    for image in itertools.islice(images, _PHOTOS_TO_SEARCH):
        found = find_outlines(to_grey(image), boards)
        outlines += found
        with_board += bool(found)
        if with_board == _PHOTOS_FOR_FOCAL:
            break
    height, width = size
    return PhotoCamera(estimate_focal(outlines, (width, height)), "estimated")
