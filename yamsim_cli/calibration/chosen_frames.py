"""Choose an episode's pictures: different poses of slow arms, and a background without the moving arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.geometry.se3 import Array
from ..core.images.image import Image
from .episode_pictures import EpisodePictures

_MAX_SPEED = 0.6  # rad/s of the fastest joint, up to which an arm counts as slow
_SLOW_SHARE = 0.3  # share of the slowest pictures that count as slow in any case
_JOINT_WEIGHTS = (1.0, 1.0, 1.0, 0.5, 0.5, 0.25)  # of a joint's angle in the distance of poses: its reach, about
_BACKGROUND_FRAMES = 24  # pictures of an episode whose median is the background
_MIN_BACKGROUND_FRAMES = 6  # with fewer, an episode has the background of all
_MIN_UNCOVERED = 3  # pictures in which a pixel is uncovered, for a known background
CHANGE_BLUR = 0.8  # px, sigma before the difference to the background
_MASK_THRESHOLD = 20.0  # grey levels; shadows and noise are mostly below
_NOISE_FACTOR = 6.0  # times the picture's noise, for the same
# A shadow darkens all colours alike, to these shares of the background, within this deviation of the shares.
_SHADOW = (0.4, 0.97)
_SHADOW_TINT = 0.08


@dataclass(frozen=True)
class ChosenFrame:
    """A picture that the fit uses, without lens distortion.

    Attributes:
        episode: number of the episode.
        picture: number of the camera's picture in the episode.
        time: s.
        image: RGB (height, width, 3).
        grey: (height, width).
        change: difference to the background (height, width), grey levels.
        background: number of the background.
        known: mask (height, width) of the pixels whose background is known.
        changed: mask (height, width) of the pixels that differ from the background, without shadows.
    """

    episode: int
    picture: int
    time: float
    image: Image
    grey: Image
    background: int
    known: NDArray[np.bool_]
    change: Image
    changed: NDArray[np.bool_]


def spread_choice(poses: Array, count: int) -> list[int]:
    """Return the indices of at most `count` rows of poses (n, k) that are far from each other, in order."""
    if len(poses) <= count:
        return list(range(len(poses)))
    chosen = [int(np.linalg.norm(poses - np.median(poses, axis=0), axis=1).argmin())]
    far = np.linalg.norm(poses - poses[chosen[0]], axis=1)
    while len(chosen) < count and far.max() > 0:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(poses - poses[chosen[-1]], axis=1))
    return sorted(chosen)


def weighted_poses(episode: EpisodePictures, times: Array) -> Array:
    """Return the arms' weighted joints (n, arms x dof) at times (n,)."""
    columns = []
    for joints in episode.joints:
        weights = np.resize(_JOINT_WEIGHTS, joints.shape[1])
        columns += [np.interp(times, episode.times, joints[:, k]) * weights[k] for k in range(joints.shape[1])]
    return np.stack(columns, axis=1)


def choose_pictures(episodes: Sequence[EpisodePictures], camera: str, count: int) -> list[list[int]]:
    """Return the numbers of a camera's pictures to use, by episode: at most `count`, slow and different."""
    poses, origin = [], []
    for number, episode in enumerate(episodes):
        if camera not in episode.cameras:
            continue
        times = episode.cameras[camera].times
        speed = np.max(
            [
                np.abs([np.interp(times, episode.times, rows[:, k]) for k in range(rows.shape[1])]).max(axis=0)
                for rows in episode.velocities
            ],
            axis=0,
        )
        slow = np.flatnonzero(speed <= max(_MAX_SPEED, float(np.quantile(speed, _SLOW_SHARE))))
        poses.append(weighted_poses(episode, times[slow]))
        origin += [(number, int(k)) for k in slow]
    chosen = spread_choice(np.concatenate(poses), count)
    by_episode: list[list[int]] = [[] for _ in episodes]
    for index in chosen:
        by_episode[origin[index][0]].append(origin[index][1])
    return by_episode


@dataclass(frozen=True)
class BackgroundPicture:
    """A picture (height, width, 3) of which a background is the median, with its episode and time, s."""

    episode: int
    time: float
    image: Image


@dataclass(frozen=True)
class Background:
    """A background (height, width, 3), and a mask (height, width) of the pixels at which it is known."""

    image: Image
    known: NDArray[np.bool_]


def background_pictures(episode: EpisodePictures, camera: str) -> list[int]:
    """Return the numbers of pictures for the background: different poses."""
    times = episode.cameras[camera].times
    return spread_choice(weighted_poses(episode, times), _BACKGROUND_FRAMES)


def is_enough_background(pictures: Sequence[int]) -> bool:
    """Return whether an episode's own pictures suffice for its background."""
    return len(pictures) >= _MIN_BACKGROUND_FRAMES


def median_background(pictures: Sequence[BackgroundPicture]) -> Background:
    """Return the median of each pixel."""
    image = np.median(np.stack([one.image for one in pictures]), axis=0).astype(np.uint8)
    return Background(image, np.ones(image.shape[:2], dtype=bool))


def uncovered_background(pictures: Sequence[BackgroundPicture], covered: Sequence[NDArray[np.bool_]]) -> Background:
    """Return the median of each pixel over the pictures in which nothing covers it, by masks (height, width)."""
    stack = np.ma.masked_array(
        np.stack([one.image for one in pictures]), np.repeat(np.stack(covered)[..., None], 3, axis=-1)
    )
    middle = np.ma.median(stack, axis=0)  # type: ignore[no-untyped-call]
    known = (~np.stack(covered)).sum(axis=0) >= _MIN_UNCOVERED
    return Background(middle.filled(0).astype(np.uint8), known)


def compare_with_background(
    frame: tuple[int, int, float], image: Image, number: int, background: Background
) -> ChosenFrame:
    """Return a picture, `frame` being its episode, number and time, with its difference to a background."""
    own, behind = (cv2.GaussianBlur(one, (0, 0), CHANGE_BLUR).astype(np.float32) for one in (image, background.image))
    signed = own - behind
    # The exposure may have changed: its level is the level of most pixels.
    signed -= np.median(signed, axis=(0, 1), keepdims=True)
    change = np.abs(signed).max(axis=2)
    noise = 1.4826 * float(np.median(change))
    changed = (change > max(_MASK_THRESHOLD, _NOISE_FACTOR * noise)).astype(np.uint8)
    changed[_is_shadow(behind + signed, behind)] = 0
    kernel = np.ones((3, 3), np.uint8)
    changed = cv2.morphologyEx(cv2.morphologyEx(changed, cv2.MORPH_OPEN, kernel), cv2.MORPH_CLOSE, kernel)
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    return ChosenFrame(
        *frame,
        image=image,
        grey=grey,
        background=number,
        known=background.known,
        change=np.minimum(change, 255).astype(np.uint8),
        changed=changed.astype(bool),
    )


def _is_shadow(own: NDArray[np.float32], behind: NDArray[np.float32]) -> NDArray[np.bool_]:
    share = (own + 1.0) / (behind + 1.0)
    middle = share.mean(axis=2)
    tint = np.abs(share - middle[..., None]).max(axis=2) / np.maximum(middle, 0.1)
    shadow: NDArray[np.bool_] = (middle > _SHADOW[0]) & (middle < _SHADOW[1]) & (tint < _SHADOW_TINT)
    return shadow
