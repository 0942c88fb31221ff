"""Find exchanged arms and exchanged wrist cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..core.config.rig import RigConfig
from ..core.geometry.se3 import Array
from ..core.images.image import Image
from ..core.rendering.view_cameras import resize_area
from .episode_pictures import EpisodePictures

_PAIRS = 60  # pairs of pictures in a row that are compared, of all episodes together
_MIN_PAIRS = 16  # with fewer, chance may decide
_WIDTH = 80  # px, to which pictures are reduced before they are compared
_MIN_CORRELATION = 0.4  # of a wrist camera's changes with an arm's moves, for a verdict
_MIN_LEAD = 0.2  # of that correlation over the one with the other arm


@dataclass(frozen=True)
class WristCameraMoves:
    """How well a wrist camera's pictures change with the moves of each arm, as rank correlations (arms,).

    `arm` is the number of the arm that carries the camera, by the rig.
    """

    name: str
    arm: int
    correlations: Array

    @property
    def is_on_other_arm(self) -> bool:
        """Whether the pictures change with another arm than the camera's."""
        own, best = float(self.correlations[self.arm]), float(self.correlations.max())
        return best >= _MIN_CORRELATION and best >= own + _MIN_LEAD


def exchange_arms(episodes: Sequence[EpisodePictures]) -> list[EpisodePictures]:
    """Return episodes in which each of two arms has the other's joints."""
    return [replace(one, joints=one.joints[::-1], openings=one.openings[::-1]) for one in episodes]


def has_two_equal_arms(rig: RigConfig) -> bool:
    """Return whether a rig's two arms have joints of the same number, so that exchanged ones go unnoticed."""
    return len(rig.arms) == 2 and rig.arms[0].robot.dof == rig.arms[1].robot.dof


def measure_wrist_cameras(episodes: Sequence[EpisodePictures], rig: RigConfig) -> list[WristCameraMoves]:
    """Return how the pictures of each wrist camera change with the arms of a rig of two arms."""
    if len(rig.arms) != 2:
        return []
    found = []
    for arm, config in enumerate(rig.arms):
        name = config.wrist_camera_name
        seen = [one for one in episodes if name in one.cameras]
        if not seen:
            continue
        changes, moves = [], []
        for episode in seen:
            own, by_arm = _changes_and_moves(episode, name, max(2, _PAIRS // len(seen)))
            changes += own
            moves += by_arm
        if len(changes) >= _MIN_PAIRS:
            found.append(WristCameraMoves(name, arm, rank_correlations(np.array(changes), np.array(moves))))
    return found


def _changes_and_moves(episode: EpisodePictures, camera: str, count: int) -> tuple[list[float], list[list[float]]]:
    """Return, for pairs of pictures in a row, the change of the picture and the moves of the arms, rad."""
    pictures = episode.cameras[camera]
    firsts = (
        np.unique(np.linspace(0, len(pictures.times) - 2, count).round().astype(int)) if count else np.zeros(0, int)
    )
    firsts = firsts[firsts >= 0]
    wanted = sorted({int(k) for first in firsts for k in (first, first + 1)})
    small = {k: _reduced(image) for k, image in zip(wanted, pictures.read(wanted), strict=True)}
    changes, moves = [], []
    for first in firsts.tolist():
        changes.append(float(np.abs(small[first + 1] - small[first]).mean()))
        before, after = (episode.postures_at(float(pictures.times[k])) for k in (first, first + 1))
        moves.append([float(np.abs(b.joints - a.joints).sum()) for a, b in zip(before, after, strict=True)])
    return changes, moves


def _reduced(image: Image) -> Array:
    height, width = image.shape[:2]
    size = _WIDTH, max(1, round(_WIDTH * height / width))
    grey = cv2.cvtColor(resize_area(image, *size), cv2.COLOR_RGB2GRAY)
    return np.asarray(grey, dtype=np.float64)


def rank_correlations(changes: Array, moves: Array) -> Array:
    """Return Spearman's correlation of changes (n,) with each column of moves (n, arms); 0 for a constant."""
    from scipy.stats import rankdata  # takes half a second to load

    ranks = rankdata(changes)
    found = []
    for column in moves.T:
        other = rankdata(column)
        spread = float(ranks.std() * other.std())
        found.append(0.0 if spread == 0 else float(((ranks - ranks.mean()) * (other - other.mean())).mean()) / spread)
    return np.array(found)


def wrist_camera_fault(
    cameras: Sequence[WristCameraMoves], arm_names: Sequence[str], *, are_arms_exchanged: bool = False
) -> str | None:
    """Return a line about wrist cameras whose pictures change with the other arm; None if there are none.

    `are_arms_exchanged` says that a fixed camera shows exchanged joints, which explain this too.
    """
    wrong = [one for one in cameras if one.is_on_other_arm]
    if not wrong:
        return None
    if len(wrong) == 2:
        names = " and ".join(one.name for one in wrong)
        if are_arms_exchanged:
            return (
                f"the pictures of {names} change when the other's arm moves: like the fixed cameras, they show that "
                "the arms' joints are exchanged; import the recording with --swap-arms"
            )
        return (
            f"{names} seem exchanged: each one's pictures change when the other's arm moves; exchange the names of the "
            "cameras or, if the fixed cameras are refused too, the arms' joints (import --swap-arms)"
        )
    (one,) = wrong
    other = arm_names[int(one.correlations.argmax())]
    return f"{one.name} seems to be on {other}: its pictures change when {other} moves; check the cameras' names"
