"""Prepare a camera's pictures for the fit: choose, undistort, compare with the background, and tell moving bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.config.rig import RigConfig
from ..core.errors import DatasetError
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array, invert_pose
from ..core.images.image import Image
from ..photos.overlay.body_views import BodyRenderer
from .chosen_frames import (
    ChosenFrame,
    background_pictures,
    choose_pictures,
    compare_with_background,
    is_enough_background,
    median_image,
)
from .episode_pictures import EpisodePictures
from .pose_search import MaskView
from .station_fit import MOVING, STILL, UNCLEAR, CameraView

_POINT_SPACING = 0.008  # m between the surface points of a body
_SAME_PLACE = 0.01  # m; a body that moved less has the same place in two pictures, about
_MOVING_SHARE = 0.7  # share of the background's pictures in which a moving body is elsewhere
_STILL_SHARE = 0.1  # the same, at most, for a still body


@dataclass(frozen=True)
class PreparedCamera:
    """A camera's pictures, and what the search for its pose needs."""

    view: CameraView
    masks: tuple[MaskView, ...]


@dataclass(frozen=True)
class _Background:
    image: Image
    times: tuple[tuple[int, float], ...]  # episode and time of each picture


def prepare_camera(
    name: str,
    episodes: Sequence[EpisodePictures],
    rig: RigConfig,
    renderer: BodyRenderer,
    camera: CameraModel,
    count: int,
) -> PreparedCamera:
    """Read at most `count` pictures of a camera.

    Raises:
        DatasetError: a picture is damaged, or has another size than the camera.
    """
    chosen = choose_pictures(episodes, name, count)
    backgrounds: list[_Background | None] = []
    images: dict[tuple[int, int], Image] = {}
    spare: list[Image] = []
    spare_times: list[tuple[int, float]] = []
    for number, episode in enumerate(episodes):
        backgrounds.append(None)
        if name not in episode.cameras:
            continue
        pictures = episode.cameras[name]
        behind = background_pictures(episode, name)
        wanted = sorted({*behind, *chosen[number]})
        flat = dict(zip(wanted, _flat_images(episode, name, wanted, renderer, camera), strict=True))
        images.update({(number, k): flat[k] for k in chosen[number]})
        times = [(number, float(pictures.times[k])) for k in behind]
        if is_enough_background(behind):
            backgrounds[number] = _Background(median_image([flat[k] for k in behind]), tuple(times))
        else:
            spare += [flat[k] for k in behind]
            spare_times += times
    shared = _Background(median_image(spare), tuple(spare_times)) if spare else None
    frames, behind_frames = [], []
    for (number, k), image in sorted(images.items(), key=lambda item: item[0]):
        background = backgrounds[number] or shared
        assert background is not None  # each picture is in one of the two
        time = float(episodes[number].cameras[name].times[k])
        frames.append(compare_with_background(number, k, time, image, background.image))
        behind_frames.append(background)
    places = _BodyPlaces(rig, renderer, episodes)
    kinds = np.array([places.kinds(frame, b.times) for frame, b in zip(frames, behind_frames, strict=True)])
    masks = tuple(
        MaskView(frame.changed, places.points(frame, own == MOVING)) for frame, own in zip(frames, kinds, strict=True)
    )
    return PreparedCamera(CameraView(name, renderer, tuple(frames), kinds), masks)


def _flat_images(
    episode: EpisodePictures, name: str, wanted: Sequence[int], renderer: BodyRenderer, camera: CameraModel
) -> list[Image]:
    flat = []
    for k, image in zip(wanted, episode.cameras[name].read(wanted), strict=True):
        height, width = image.shape[:2]
        if (width, height) != (camera.width, camera.height):
            raise DatasetError(
                f"{episode.name}: {name}, picture {k} has {width} x {height} pixels, and the camera is calibrated for "
                f"{camera.width} x {camera.height}; give the camera file of this size"
            )
        flat.append(renderer.undistort_photo(image))
    return flat


class _BodyPlaces:
    """Where the arms' bodies are in the reference base's frame, by the measured joints."""

    def __init__(self, rig: RigConfig, renderer: BodyRenderer, episodes: Sequence[EpisodePictures]) -> None:
        self._renderer, self._episodes = renderer, episodes
        to_reference = invert_pose(rig.T_base_in_world(rig.recording_order[0]))
        self._bases = {k: to_reference @ rig.T_base_in_world(k) for k in range(len(rig.arms))}
        self._points = renderer.surface_points(_POINT_SPACING)
        # Four points of a body tell its place: their distances to those elsewhere are about those of its surface.
        self._corners = [
            np.array([points.mean(axis=0) + 0.05 * axis for axis in np.eye(3)]) if len(points) else None
            for points in self._points
        ]
        self._known: dict[tuple[int, float], Array] = {}

    def _poses(self, episode: int, time: float) -> Array:
        if (episode, time) not in self._known:
            self._renderer.set_poses(self._bases, self._episodes[episode].postures_at(time))
            self._known[episode, time] = self._renderer.body_poses()
        return self._known[episode, time]

    def kinds(self, frame: ChosenFrame, behind: Sequence[tuple[int, float]]) -> NDArray[np.uint8]:
        """Return `MOVING`, `STILL` or `UNCLEAR` by body (nbody,), by its places in the background's pictures."""
        here = self._poses(frame.episode, frame.time)
        kinds = np.zeros(len(here), np.uint8)
        for body, corners in enumerate(self._corners):
            if corners is None:
                continue
            at = _transformed(here[body], corners)
            far = [
                float(np.abs(_transformed(self._poses(*one)[body], corners) - at).max()) > _SAME_PLACE for one in behind
            ]
            elsewhere = float(np.mean(far))
            kinds[body] = MOVING if elsewhere > _MOVING_SHARE else STILL if elsewhere <= _STILL_SHARE else UNCLEAR
        return kinds

    def points(self, frame: ChosenFrame, bodies: NDArray[np.bool_]) -> Array:
        """Return the surface points (n, 3) of some bodies (nbody,) in a picture."""
        here = self._poses(frame.episode, frame.time)
        found = [_transformed(here[body], self._points[body]) for body in np.flatnonzero(bodies)]
        return np.concatenate(found) if found else np.zeros((0, 3))


def _transformed(T: Array, points: Array) -> Array:
    moved: Array = points @ T[:3, :3].T + T[:3, 3]
    return moved
