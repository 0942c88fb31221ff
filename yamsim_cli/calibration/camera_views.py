"""Prepare a camera's pictures for the fit: choose, undistort, compare with the background, and find moving bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.config.rig import RigConfig
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array, invert_pose
from ..core.images.image import Image
from ..photos.overlay.body_views import BodyRenderer
from .chosen_frames import (
    BackgroundPicture,
    ChosenFrame,
    background_pictures,
    choose_pictures,
    compare_with_background,
    is_enough_background,
    median_background,
    uncovered_background,
)
from .episode_pictures import EpisodePictures
from .pose_search import MaskView
from .station_fit import MOVING, STILL, UNCLEAR, FittedCameraView, StationState

_POINT_SPACING = 0.008  # m between the surface points of a body
_SAME_PLACE = 0.01  # m; a body that moved less has the same place in two pictures, about
_MOVING_SHARE = 0.7  # share of the background's pictures in which a moving body is elsewhere
_STILL_SHARE = 0.1  # the same, at most, for a still body
_ARM_EDGE = 7  # px, by which arms are widened when they are removed from a background


@dataclass(frozen=True)
class PreparedCamera:
    """A camera's pictures, and what the search for its pose needs.

    Attributes:
        masks: what has changed in each picture.
        backgrounds: the pictures of each background.
    """

    view: FittedCameraView
    masks: tuple[MaskView, ...]
    backgrounds: tuple[tuple[BackgroundPicture, ...], ...]


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
    images: list[tuple[tuple[int, int, float], Image]] = []
    own: list[tuple[BackgroundPicture, ...]] = [()]  # the first background is for all short episodes
    background_of: dict[int, int] = {}
    for number, episode in enumerate(episodes):
        if name not in episode.cameras:
            continue
        times = episode.cameras[name].times
        behind = background_pictures(episode, name)
        wanted = sorted({*behind, *chosen[number]})
        read = [renderer.undistort_photo(one) for one in episode.read_pictures(name, wanted, camera)]
        flat = dict(zip(wanted, read, strict=True))
        images += [((number, k, float(times[k])), flat[k]) for k in chosen[number]]
        pictures = tuple(BackgroundPicture(number, float(times[k]), flat[k]) for k in behind)
        if is_enough_background(behind):
            background_of[number] = len(own)
            own.append(pictures)
        else:
            background_of[number] = 0
            own[0] += pictures
    medians = [median_background(pictures) if pictures else None for pictures in own]
    frames, places, kinds = [], _BodyPlaces(rig, renderer, episodes), []
    for frame, image in images:
        group = background_of[frame[0]]
        background = medians[group]
        assert background is not None  # each episode has pictures in its background
        frames.append(compare_with_background(frame, image, group, background))
        kinds.append(places.kinds(frames[-1], [(one.episode, one.time) for one in own[group]]))
    masks = tuple(
        MaskView(frame.changed, places.points(frame, kind == MOVING)) for frame, kind in zip(frames, kinds, strict=True)
    )
    return PreparedCamera(FittedCameraView(name, renderer, tuple(frames), np.array(kinds)), masks, tuple(own))


def with_clean_backgrounds(
    prepared: PreparedCamera, state: StationState, camera: int, episodes: Sequence[EpisodePictures]
) -> PreparedCamera:
    """Return the pictures compared with backgrounds from which the arms are removed, by an estimate of their places."""
    view = prepared.view
    moving = ((view.kinds == MOVING) | (view.kinds == UNCLEAR)).any(axis=0)
    backgrounds = []
    for pictures in prepared.backgrounds:
        covered = []
        for one in pictures:
            view.show(state, camera, episodes[one.episode], one.time)
            arms = moving[view.renderer.body_picture().bodies]
            covered.append(cv2.dilate(arms.astype(np.uint8), np.ones((_ARM_EDGE, _ARM_EDGE), np.uint8)) > 0)
        backgrounds.append(uncovered_background(pictures, covered) if pictures else None)
    frames = []
    for frame in view.frames:
        background = backgrounds[frame.background]
        assert background is not None  # each frame has a background
        place = (frame.episode, frame.picture, frame.time)
        frames.append(compare_with_background(place, frame.image, frame.background, background))
    # Behind bodies that stay near their places, the background is now known too.
    kinds = np.where(view.kinds == UNCLEAR, MOVING, view.kinds).astype(np.uint8)
    return replace(prepared, view=replace(view, frames=tuple(frames), kinds=kinds))


class _BodyPlaces:
    """Where the arms' bodies are in the reference base's frame, by the measured joints."""

    def __init__(self, rig: RigConfig, renderer: BodyRenderer, episodes: Sequence[EpisodePictures]) -> None:
        self._renderer, self._episodes = renderer, episodes
        to_reference = invert_pose(rig.T_base_in_world(rig.recording_order[0]))
        self._bases = {k: to_reference @ rig.T_base_in_world(k) for k in range(len(rig.arms))}
        self._points = renderer.surface_points(_POINT_SPACING)
        # Three points determine the pose of a body. Between two pictures, they move about as far as its surface.
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
