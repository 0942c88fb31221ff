"""When a camera or an arm's base was moved, from a series of photos by one camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from ..geometry.se3 import Array, inverse, pose, rotation_from_vector, rotation_vector
from .arm_poses import ArmPose, PhotoResult
from .steps import FEWEST, Step, find_steps, noise_of, step_at

# What moves less is not told, m and rad: the arm, in front of its board, shifts the board's pose by some of that.
_LEAST_SHIFT = 5e-4
_LEAST_TURN = math.radians(0.1)
# Noise is at least this, m and rad: photos that are alike to the last grey level would have none.
_NOISE_SHIFT = 5e-5
_NOISE_TURN = math.radians(0.01)
# Steps of two boards so few photos apart are one event.
_TOGETHER = 3
# Poses that differ from photo to photo by so many times what the photos' noise does are of a camera in a hand.
_IN_A_HAND = 8.0
# So are several steps in fewer photos each.
_PHOTOS_A_STEP = 12


class Moved(StrEnum):
    """What was moved."""

    CAMERA = "camera"
    BASE = "base"
    # One board alone is in sight: its base and the camera look alike.
    EITHER = "camera or base"
    # More than one thing moved at once.
    SEVERAL = "several"


@dataclass(frozen=True)
class Move:
    """Something that was moved between two photos.

    Attributes:
        photo: number of the first photo after it, among all.
        path: that photo.
        time: of that photo, s; None where photos have no times.
        what: what was moved.
        arm: whose base it is, or whose board it is seen by.
        shift: how far, m: of a base its own origin's, of a camera the camera's.
        turn: by which angle, rad.
        shift_sigma, turn_sigma: their standard deviations.
        shift_in_base: (3,) the shift along the axes of the arm's base before it, m.
    """

    photo: int
    path: Path
    time: float | None
    what: Moved
    arm: str
    shift: float
    turn: float
    shift_sigma: float
    turn_sigma: float
    shift_in_base: Array


@dataclass(frozen=True)
class Stillness:
    """Whether camera and bases stayed where they were.

    Attributes:
        moves: in order.
        unknown: why nothing can be said; empty otherwise.
    """

    moves: tuple[Move, ...] = ()
    unknown: str = ""


def find_moves(results: Sequence[PhotoResult]) -> Stillness:
    """What was moved while a series of photos was taken by a camera on a stand.

    Each board's pose in the camera is looked at over time. A level that steps is a move: of the camera, where all
    boards moved by the same motion, and of a base, where its board moved and another did not.
    """
    arms = range(len(results[0].arms)) if results else range(0)
    series = [track for k in arms if (track := _track(results, k)) is not None]
    if not series:
        return Stillness(unknown=f"fewer than {2 * FEWEST} photos have a pose from a board")
    found = [(track, step) for track in series for step in track.steps()]
    if any(track.restless for track in series):
        return Stillness(unknown="the camera is not on a stand: it moves all along")
    moves: list[Move] = []
    for together in _events(found):
        moves += _judge(results, series, together)
    return Stillness(tuple(sorted(moves, key=lambda move: move.photo)))


class _Track:
    """A board's pose over time, as motions from its pose in the middle photo.

    Attributes:
        arm: number of the arm.
        photos: numbers (n,) of the photos that have the pose.
        small: the motions (n, 6): turns, rad, and shifts, m, along the camera's axes.
    """

    def __init__(self, arm: int, photos: list[int], boards: list[Array], bases: list[Array], least: Array) -> None:
        self.arm = arm
        self.photos = np.array(photos)
        self._board, self._T_base_in_board = boards[len(boards) // 2], inverse(boards[0]) @ bases[0]
        self.small = np.array([_small(T, self._board) for T in boards])
        self._least = least
        self._steps: list[Step] | None = None

    def steps(self) -> list[Step]:
        """Where the board's pose steps by enough to be told."""
        if self._steps is None:
            self._steps = [step for step in find_steps(self.small, self._least) if _matters(step)]
        return self._steps

    def at(self, photo: int) -> Step | None:
        """What a step before a photo would be, between its neighbouring steps; None with too few photos on a side."""
        cut = int(np.searchsorted(self.photos, photo))
        edges = [0, *(step.at for step in self.steps() if abs(step.at - cut) > _TOGETHER), len(self.photos)]
        low = max(edge for edge in edges if edge <= cut)
        high = min(edge for edge in edges if edge >= cut)
        if cut - low < FEWEST or high - cut < FEWEST:
            return None
        return step_at(self.small[low:high], cut - low, noise_of(self.small, self._least))

    @property
    def restless(self) -> bool:
        """Whether the camera hardly rests."""
        steps = len(self.steps())
        shaken = float(np.median(noise_of(self.small, self._least) / self._least))
        return shaken > _IN_A_HAND or (steps > 1 and steps * _PHOTOS_A_STEP > len(self.photos))

    @property
    def lever(self) -> float:
        """How far the base's origin is from the board's, m."""
        return float(np.linalg.norm(self._T_base_in_board[:3, 3]))

    def base(self, small: Array) -> Array:
        """The base's pose (4, 4) in the camera where the board's is `small` (6,) from the middle one."""
        return _moved(self._board, small) @ self._T_base_in_board


def _track(results: Sequence[PhotoResult], k: int) -> _Track | None:
    """Of the k-th arm; None with too few photos."""
    photos, boards, bases, noise = [], [], [], []
    for number, result in enumerate(results):
        arm = result.arms[k]
        seen = arm.sighting
        if seen is None or seen.T_board_in_cam is None or arm.T_base_in_cam is None or not _own(arm):
            continue
        photos.append(number)
        boards.append(seen.T_board_in_cam)
        bases.append(arm.T_base_in_cam)
        noise.append(_own_noise(arm))
    if len(photos) < 2 * FEWEST:
        return None
    return _Track(k, photos, boards, bases, np.median(noise, axis=0))


def _own(arm: ArmPose) -> bool:
    """Whether a pose is its own board's, as it was seen."""
    return arm.status == "ok"


def _own_noise(arm: ArmPose) -> Array:
    """Standard deviations (6,) of what a photo says of a board by the photo's own noise, rad and m.

    What the lens and the print's scale are known to is the same in all photos of a series.
    """
    seen = arm.sighting
    least = np.array([_NOISE_TURN] * 3 + [_NOISE_SHIFT] * 3)
    if seen is None or seen.covariance is None or seen.shared is None:
        return least
    own = np.diag(seen.covariance) - np.sum(seen.shared**2, axis=1)
    noise: Array = np.maximum(np.sqrt(np.maximum(own, 0.0)), least)
    return noise


def _small(T: Array, of: Array) -> Array:
    """The motion (6,) from a pose to another: a turn about its origin, rad, and a shift, m, along the axes outside."""
    return np.concatenate([rotation_vector(T[:3, :3] @ of[:3, :3].T), T[:3, 3] - of[:3, 3]])


def _moved(T: Array, small: Array) -> Array:
    return pose(T[:3, 3] + small[3:], rotation_from_vector(small[:3]) @ T[:3, :3])


def _matters(step: Step) -> bool:
    turn, shift = np.linalg.norm((step.after - step.before).reshape(2, 3), axis=1)
    return bool(turn >= _LEAST_TURN or shift >= _LEAST_SHIFT)


def _events(found: list[tuple[_Track, Step]]) -> list[list[tuple[_Track, Step]]]:
    """Steps of several boards at about the same photo, together."""
    events: list[list[tuple[_Track, Step]]] = []
    for track, step in sorted(found, key=lambda one: one[0].photos[one[1].at]):
        last = events[-1] if events else []
        near = last and track.photos[step.at] - last[0][0].photos[last[0][1].at] <= _TOGETHER
        if near and all(other.arm != track.arm for other, _ in last):
            last.append((track, step))
        else:
            events.append([(track, step)])
    return events


def _judge(results: Sequence[PhotoResult], series: list[_Track], event: list[tuple[_Track, Step]]) -> list[Move]:
    """What was moved in an event, from the boards that stepped and those that did not."""
    track, step = max(event, key=lambda one: one[1].strength)
    photo = int(track.photos[step.at])
    others = [(other, beside) for other in series if other is not track and (beside := other.at(photo)) is not None]
    if not others:
        return [_move(results, track, step, photo, Moved.EITHER)]
    other, beside = others[0]
    stepped = {one.arm for one, _ in event}
    if other.arm not in stepped:
        return [_move(results, track, step, photo, Moved.BASE)]
    if _alike((track, step), (other, beside)):
        return [_move(results, track, step, photo, Moved.CAMERA)]
    return [_move(results, *one, photo, Moved.SEVERAL) for one in ((track, step), (other, beside))]


def _alike(one: tuple[_Track, Step], other: tuple[_Track, Step]) -> bool:
    """Whether two bases stand to each other after an event as before it."""
    (track, step), (beside, its) = one, other
    apart = [
        inverse(track.base(step.before)) @ beside.base(its.before),
        inverse(track.base(step.after)) @ beside.base(its.after),
    ]
    small = _small(apart[1], apart[0])
    sigma = [_sigma(*each) for each in (one, other)]
    turn, shift = math.hypot(sigma[0][1], sigma[1][1]), math.hypot(sigma[0][0], sigma[1][0])
    reach = float(np.linalg.norm(apart[0][:3, 3]))
    return bool(
        np.linalg.norm(small[:3]) <= max(4 * turn, _LEAST_TURN)
        and np.linalg.norm(small[3:]) <= max(4 * (shift + reach * turn), _LEAST_SHIFT + reach * _LEAST_TURN)
    )


def _sigma(track: _Track, step: Step) -> tuple[float, float]:
    """Standard deviations of a base's shift (m) and turn (rad), all axes together."""
    turn = float(np.linalg.norm(step.sigma[:3]))
    return math.hypot(float(np.linalg.norm(step.sigma[3:])), track.lever * turn), turn


def _move(results: Sequence[PhotoResult], track: _Track, step: Step, photo: int, what: Moved) -> Move:
    before, after = track.base(step.before), track.base(step.after)
    shift_sigma, turn_sigma = _sigma(track, step)
    if what is Moved.CAMERA:
        change = inverse(after)[:3, 3] - inverse(before)[:3, 3]
    else:
        change = before[:3, :3].T @ (after[:3, 3] - before[:3, 3])
    turn = float(np.linalg.norm(rotation_vector(after[:3, :3] @ before[:3, :3].T)))
    result = results[photo]
    return Move(
        photo,
        result.path,
        result.time,
        what,
        result.arms[track.arm].name,
        float(np.linalg.norm(change)),
        turn,
        shift_sigma,
        turn_sigma,
        change,
    )
