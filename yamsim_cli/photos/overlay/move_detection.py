"""When a camera or an arm's base was moved, from a series of photos by one camera.

Each board's pose in the camera's frame is a series of vectors (6,). Where the level of a series steps, something moved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

import numpy as np

from yamsim_cli.core.geometry.se3 import Array, inverse, pose, rotation_from_vector, rotation_vector

from ..fiducials.board_detection import BoardStatus
from .photo_arm_poses import ArmPose, RigInPhoto

# Smallest reported move. An arm in front of its board shifts the board's pose by some of that.
_LEAST_SHIFT = 5e-4  # m
_LEAST_TURN = math.radians(0.1)  # rad
# Smallest standard deviation of a pose. Photos that are equal to the last grey level would have none.
_NOISE_SHIFT = 5e-5  # m
_NOISE_TURN = math.radians(0.01)  # rad
_TOGETHER = 3  # photos, largest distance between steps of two boards that are one event
_IN_A_HAND = 8.0  # ratio of the poses' noise to that of the photos, above which a person holds the camera
_PHOTOS_A_STEP = 12  # photos for each of several steps, below which a person holds the camera

_FEWEST = 4  # samples of a level: with fewer, one outlier is half of the level
# Squared distance of two levels, in standard deviations, above which a step counts. By chance six independent axes
# exceed the limit once in 20 million (chi-squared, 6 degrees of freedom): no false step in a series of thousands.
_SURE = 45.0
_CLIP = 6.0  # standard deviations that a sample counts for at most, so that one wrong pose is no step
_FROM_MEDIAN = 1.4826  # from a median absolute deviation to a standard deviation, of normal noise
_MEDIAN_SPREAD = np.pi / 2  # variance of a median of n normal samples, over the variance of their mean


class MovedBody(StrEnum):
    """What was moved."""

    CAMERA = "camera"
    BASE = "base"
    EITHER = "camera or base"  # with one board in sight, a move of the base and one of the camera look alike
    SEVERAL = "several"


@dataclass(frozen=True)
class DetectedMove:
    """A move between two photos.

    Attributes:
        photo: number of the first photo after the move, among all.
        path: that photo.
        time: when that photo was taken, s; None if not known.
        arm: the arm whose base was moved, or whose board shows the move.
        shift: distance that the base's origin or the camera was moved, m.
        turn: angle, rad.
        shift_sigma, turn_sigma: their standard deviations.
        shift_in_base: (3,) the shift along the axes of the arm's base before the move, m.
    """

    photo: int
    path: Path
    time: float | None
    what: MovedBody
    arm: str
    shift: float
    turn: float
    shift_sigma: float
    turn_sigma: float
    shift_in_base: Array


@dataclass(frozen=True)
class MoveReport:
    """Whether camera and bases stayed where they were.

    Attributes:
        moves: in order.
        unknown: why nothing is known; empty otherwise.
    """

    moves: tuple[DetectedMove, ...] = ()
    unknown: str = ""


def describe_move(move: DetectedMove) -> str:
    """A line on a move: the photo, what was moved, and by how much."""
    by = (
        f"{move.shift * 1000:.1f} mm (sigma {move.shift_sigma * 1000:.2f}) and "
        f"{math.degrees(move.turn):.2f} degrees (sigma {math.degrees(move.turn_sigma):.3f})"
    )
    what = {
        MovedBody.CAMERA: "the camera was moved",
        MovedBody.BASE: f"the base of {move.arm} was moved",
        MovedBody.EITHER: f"the camera or the base of {move.arm} was moved (one board alone does not tell which)",
        MovedBody.SEVERAL: f"the base of {move.arm} was moved against the camera, and the others otherwise",
    }[move.what]
    when = f", {move.time:.2f} s" if move.time is not None else ""
    return f"{move.path} (number {move.photo}{when}): before it {what} by {by}"


def find_moves(results: Sequence[RigInPhoto]) -> MoveReport:
    """The moves in a series of photos by a camera on a stand.

    The camera moved where all boards moved by the same motion. A base moved where its board did and another did not.
    """
    arms = range(len(results[0].arms)) if results else range(0)
    tracks = [track for k in arms if (track := _track(results, k)) is not None]
    if not tracks:
        return MoveReport(unknown=f"fewer than {2 * _FEWEST} photos have a pose from a board")
    if any(track.camera_never_rests for track in tracks):
        return MoveReport(unknown="the camera is not on a stand: it moves all along")
    moves: list[DetectedMove] = []
    for event in _events([(track, step) for track in tracks for step in track.steps]):
        moves += _classify_event(results, tracks, event)
    return MoveReport(tuple(sorted(moves, key=lambda move: move.photo)))


@dataclass(frozen=True)
class _PoseStep:
    """A step of a series.

    Attributes:
        at: the first sample after the step.
        before, after: the levels (d,) on both sides, up to the neighbouring steps.
        sigma: standard deviation (d,) of the difference between the levels.
        strength: the squared difference in standard deviations, all axes together.
    """

    at: int
    before: Array
    after: Array
    sigma: Array
    strength: float


class _BoardTrack:
    """A board's pose over time, as motions from its pose in the middle photo.

    Attributes:
        arm: number of the arm.
        photos: numbers (n,) of the photos that have the pose.
        motions: (n, 6): turns, rad, and shifts, m, along the camera's axes.
    """

    def __init__(self, arm: int, photos: list[int], boards: list[Array], bases: list[Array], minimum: Array) -> None:
        self.arm = arm
        self.photos = np.array(photos)
        self._board, self._T_base_in_board = boards[len(boards) // 2], inverse(boards[0]) @ bases[0]
        self.motions = np.array([_relative_motion(T, self._board) for T in boards])
        self._least = minimum

    @cached_property
    def steps(self) -> list[_PoseStep]:
        """Where the board's pose steps by enough to be reported."""
        return [step for step in _find_steps(self.motions, self._least) if _is_significant(step)]

    def step_before(self, photo: int) -> _PoseStep | None:
        """The difference between the levels on both sides of a photo, up to the neighbouring steps; None if too few."""
        cut = int(np.searchsorted(self.photos, photo))
        edges = [0, *(step.at for step in self.steps if abs(step.at - cut) > _TOGETHER), len(self.photos)]
        low = max(edge for edge in edges if edge <= cut)
        high = min(edge for edge in edges if edge >= cut)
        if cut - low < _FEWEST or high - cut < _FEWEST:
            return None
        return _step_at(self.motions[low:high], cut - low, _noise_of(self.motions, self._least))

    @property
    def camera_never_rests(self) -> bool:
        """Whether the camera hardly rests."""
        shaken = float(np.median(_noise_of(self.motions, self._least) / self._least))
        steps = len(self.steps)
        return shaken > _IN_A_HAND or (steps > 1 and steps * _PHOTOS_A_STEP > len(self.photos))

    def base(self, motion: Array) -> Array:
        """The base's pose (4, 4) in the camera's frame where the board is moved (6,) from the middle photo's pose."""
        turn = rotation_from_vector(motion[:3]) @ self._board[:3, :3]
        return pose(self._board[:3, 3] + motion[3:], turn) @ self._T_base_in_board

    def sigma(self, step: _PoseStep) -> tuple[float, float]:
        """Standard deviations of the base's shift (m) and turn (rad) in a step, all axes together."""
        turn = float(np.linalg.norm(step.sigma[:3]))
        lever = float(np.linalg.norm(self._T_base_in_board[:3, 3]))
        return math.hypot(float(np.linalg.norm(step.sigma[3:])), lever * turn), turn


def _track(results: Sequence[RigInPhoto], k: int) -> _BoardTrack | None:
    photos, boards, bases, noise = [], [], [], []
    for number, result in enumerate(results):
        arm = result.arms[k]
        board = arm.sighting.T_board_in_cam if arm.sighting else None
        if board is None or arm.T_base_in_cam is None or arm.status != BoardStatus.OK:
            continue
        photos.append(number)
        boards.append(board)
        bases.append(arm.T_base_in_cam)
        noise.append(_photo_noise(arm))
    if len(photos) < 2 * _FEWEST:
        return None
    return _BoardTrack(k, photos, boards, bases, np.median(noise, axis=0))


def _photo_noise(arm: ArmPose) -> Array:
    """Standard deviations (6,) of a board's pose, rad and m, by the photo's own noise.

    The errors of the lens and of the print's scale are the same in all photos of a series.
    """
    seen = arm.sighting
    least = np.array([_NOISE_TURN] * 3 + [_NOISE_SHIFT] * 3)
    if seen is None or seen.covariance is None or seen.shared_errors is None:
        return least
    own = np.diag(seen.covariance) - np.sum(seen.shared_errors**2, axis=1)
    noise: Array = np.maximum(np.sqrt(np.maximum(own, 0.0)), least)
    return noise


def _relative_motion(T: Array, start: Array) -> Array:
    """The motion (6,) from a start pose: a turn about its origin, rad, and a shift, m, along the axes outside."""
    return np.concatenate([rotation_vector(T[:3, :3] @ start[:3, :3].T), T[:3, 3] - start[:3, 3]])


def _is_significant(step: _PoseStep) -> bool:
    turn, shift = np.linalg.norm((step.after - step.before).reshape(2, 3), axis=1)
    return bool(turn >= _LEAST_TURN or shift >= _LEAST_SHIFT)


_TrackStep = tuple[_BoardTrack, _PoseStep]


def _events(found: list[_TrackStep]) -> list[list[_TrackStep]]:
    """Steps, grouped where several boards step at about the same photo."""
    events: list[list[_TrackStep]] = []
    for track, step in sorted(found, key=lambda one: one[0].photos[one[1].at]):
        last = events[-1] if events else []
        near = last and track.photos[step.at] - last[0][0].photos[last[0][1].at] <= _TOGETHER
        if near and all(other.arm != track.arm for other, _ in last):
            last.append((track, step))
        else:
            events.append([(track, step)])
    return events


def _classify_event(
    results: Sequence[RigInPhoto], tracks: list[_BoardTrack], event: list[_TrackStep]
) -> list[DetectedMove]:
    """What was moved in an event, from the boards that stepped and those that did not."""
    track, step = max(event, key=lambda one: one[1].strength)
    photo = int(track.photos[step.at])
    others = [(other, its) for other in tracks if other is not track and (its := other.step_before(photo)) is not None]
    if not others:
        return [_move(results, track, step, photo, MovedBody.EITHER)]
    other, its = others[0]
    if other.arm not in {one.arm for one, _ in event}:
        return [_move(results, track, step, photo, MovedBody.BASE)]
    if _same_relative_pose((track, step), (other, its)):
        return [_move(results, track, step, photo, MovedBody.CAMERA)]
    return [_move(results, *one, photo, MovedBody.SEVERAL) for one in ((track, step), (other, its))]


def _same_relative_pose(one: _TrackStep, other: _TrackStep) -> bool:
    """Whether the pose of two bases to each other is the same before and after an event."""
    (track_one, step_one), (track_two, step_two) = one, other
    before = inverse(track_one.base(step_one.before)) @ track_two.base(step_two.before)
    after = inverse(track_one.base(step_one.after)) @ track_two.base(step_two.after)
    motion = _relative_motion(after, before)
    (shift_one, turn_one), (shift_two, turn_two) = track_one.sigma(step_one), track_two.sigma(step_two)
    turn, shift = math.hypot(turn_one, turn_two), math.hypot(shift_one, shift_two)
    reach = float(np.linalg.norm(before[:3, 3]))
    return bool(
        np.linalg.norm(motion[:3]) <= max(4 * turn, _LEAST_TURN)
        and np.linalg.norm(motion[3:]) <= max(4 * (shift + reach * turn), _LEAST_SHIFT + reach * _LEAST_TURN)
    )


def _move(
    results: Sequence[RigInPhoto], track: _BoardTrack, step: _PoseStep, photo: int, what: MovedBody
) -> DetectedMove:
    before, after = track.base(step.before), track.base(step.after)
    shift_sigma, turn_sigma = track.sigma(step)
    if what is MovedBody.CAMERA:
        change = inverse(after)[:3, 3] - inverse(before)[:3, 3]
    else:
        change = before[:3, :3].T @ (after[:3, 3] - before[:3, 3])
    result = results[photo]
    return DetectedMove(
        photo,
        result.path,
        result.time,
        what,
        result.arms[track.arm].name,
        shift=float(np.linalg.norm(change)),
        turn=float(np.linalg.norm(rotation_vector(after[:3, :3] @ before[:3, :3].T))),
        shift_sigma=shift_sigma,
        turn_sigma=turn_sigma,
        shift_in_base=change,
    )


def _noise_of(series: Array, minimum: Array) -> Array:
    """Standard deviations (d,) of a series (n, d) from one sample to the next, at least `minimum` (d,).

    A few steps do not change them.
    """
    jumps = np.abs(np.diff(series, axis=0))
    sigma: Array = np.maximum(_FROM_MEDIAN * np.median(jumps, axis=0) / np.sqrt(2), minimum)
    return sigma


def _find_steps(series: Array, minimum: Array) -> list[_PoseStep]:
    """The steps of a series (n, d), in order.

    Between two steps the series stays at a level, the median of at least four samples. A single outlier is no step.

    Args:
        minimum: standard deviations (d,) that the noise has at least.
    """
    sigma = _noise_of(series, minimum)
    edges = [0, *sorted(_split(series / sigma, 0)), len(series)]
    steps = []
    for low, at, high in zip(edges, edges[1:], edges[2:], strict=False):
        step = _step_at(series[low:high], at - low, sigma)
        if step.strength > _SURE:
            steps.append(replace(step, at=at))
    return steps


def _step_at(series: Array, at: int, sigma: Array) -> _PoseStep:
    """The step before sample `at` of a series (n, d) whose noise has standard deviations `sigma` (d,)."""
    before, after = np.median(series[:at], axis=0), np.median(series[at:], axis=0)
    spread = sigma * np.sqrt(_MEDIAN_SPREAD * (1 / at + 1 / (len(series) - at)))
    return _PoseStep(at, before, after, spread, float(np.sum(((after - before) / spread) ** 2)))


def _split(series: Array, start: int) -> list[int]:
    """The samples before which a whitened series steps, found by splitting the series where two levels fit best."""
    n = len(series)
    if n < 2 * _FEWEST:
        return []
    costs = [_cost(series[:k]) + _cost(series[k:]) for k in range(_FEWEST, n - _FEWEST + 1)]
    at = _FEWEST + int(np.argmin(costs))
    if _step_at(series, at, np.ones(series.shape[1])).strength <= _SURE:
        return []
    return [*_split(series[:at], start), start + at, *_split(series[at:], start + at)]


def _cost(series: Array) -> float:
    return float(np.minimum(np.abs(series - np.median(series, axis=0)), _CLIP).sum())
