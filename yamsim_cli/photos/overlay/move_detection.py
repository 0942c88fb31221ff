"""Detect moves of the camera or of an arm's base between photos of one camera.

A lasting step in a series of a board's poses in the camera frame, as vectors (6,), indicates a move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

import numpy as np

from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_vector

from ..fiducials.board_detection import BoardStatus
from .photo_arm_poses import ArmBasePose, RigInPhoto

# Smallest reported move; an arm in front of its board shifts the estimate by part of it.
_MIN_SHIFT = 5e-4  # m
_MIN_TURN = math.radians(0.1)  # rad
# Minimum pose sigma; identical photos would give zero.
_NOISE_SHIFT = 5e-5  # m
_NOISE_TURN = math.radians(0.01)  # rad
_MAX_PHOTOS_PER_EVENT = 3  # photos between steps of two boards in one event
_HANDHELD_NOISE_RATIO = 8.0  # scatter of a pose over its sigma in one photo, of a hand-held camera
_MIN_PHOTOS_PER_STEP = 12  # if several steps have fewer, the camera is hand-held

_MIN_SAMPLES = 4  # photos; with fewer, one outlier dominates the median
# Squared pose difference in variances. Noise exceeds it once in 20 million (chi-squared, 6 degrees of freedom).
_MIN_STRENGTH = 45.0
_MAX_SAMPLE_COST = 6.0  # standard deviations a sample counts for, so that one wrong pose is no step
_SIGMA_PER_MAD = 1.4826  # standard deviation over median absolute deviation, normal noise
_MEDIAN_VARIANCE_RATIO = np.pi / 2  # variance of a median divided by the variance of a mean, normal samples


class MovedBody(StrEnum):
    """The body that moved."""

    CAMERA = "camera"
    BASE = "base"
    CAMERA_OR_BASE = "camera or base"  # one board alone does not distinguish the two
    SEVERAL = "several"


@dataclass(frozen=True)
class DetectedMove:
    """A move between two photos.

    Attributes:
        photo: number of the first photo after the move.
        path, time: of that photo; s, None if not known.
        arm: whose base moved, or whose board shows the move.
        shift, turn: of the base's origin or the camera, m and rad, with `shift_sigma` and `turn_sigma`.
        shift_in_base: (3,) along the base's axes before the move, m.
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
    """Moves in the photos' order; or `why_unknown`, why they cannot be detected, for users."""

    moves: tuple[DetectedMove, ...] = ()
    why_unknown: str = ""


def describe_move(move: DetectedMove) -> str:
    """Return a line with the photo, the body and the displacement."""
    by = (
        f"{move.shift * 1000:.1f} mm (sigma {move.shift_sigma * 1000:.2f}) and "
        f"{math.degrees(move.turn):.2f} degrees (sigma {math.degrees(move.turn_sigma):.3f})"
    )
    what = {
        MovedBody.CAMERA: "the camera was moved",
        MovedBody.BASE: f"the base of {move.arm} was moved",
        MovedBody.CAMERA_OR_BASE: f"the camera or the base of {move.arm} was moved (one board alone cannot show which)",
        MovedBody.SEVERAL: f"the base of {move.arm} was moved relative to the camera, and the other bases differently",
    }[move.what]
    when = f", {move.time:.2f} s" if move.time is not None else ""
    return f"{move.path} (number {move.photo}{when}): before this photo, {what} by {by}"


def find_moves(results: Sequence[RigInPhoto]) -> MoveReport:
    """Return the moves in photos from a camera on a tripod or stand.

    A motion that all boards share is the camera's; a motion of one board alone is its base's.
    """
    arms = range(len(results[0].arms)) if results else range(0)
    tracks = [track for k in arms if (track := _board_track(results, k)) is not None]
    if not tracks:
        return MoveReport(why_unknown=f"fewer than {2 * _MIN_SAMPLES} photos have a pose from a board")
    if any(track.camera_never_rests for track in tracks):
        return MoveReport(why_unknown="the camera is not on a stand: it moves between all photos")
    moves: list[DetectedMove] = []
    for event in _group_events([(track, step) for track in tracks for step in track.significant_steps]):
        moves += _classify_event(results, tracks, event)
    return MoveReport(tuple(sorted(moves, key=lambda move: move.photo)))


@dataclass(frozen=True)
class _PoseStep:
    """A lasting change between two levels (d,), medians between steps.

    Attributes:
        at: index of the first sample after the step.
        sigma: standard deviation (d,) of the difference.
        chi_squared: squared difference in variances, summed over axes.
    """

    at: int
    before: Array
    after: Array
    sigma: Array
    chi_squared: float


class _BoardTrack:
    """A board's motions (n, 6), rad and m along the camera's axes, from its middle photo.

    `photos` (n,) are the numbers of photos with a pose.
    """

    def __init__(self, arm: int, photos: list[int], boards: list[Array], bases: list[Array], minimum: Array) -> None:
        self.arm = arm
        self.photos = np.array(photos)
        self._board, self._T_base_in_board = boards[len(boards) // 2], invert_pose(boards[0]) @ bases[0]
        self.motions = np.array([_relative_motion(T, self._board) for T in boards])
        self._least = minimum

    @cached_property
    def significant_steps(self) -> list[_PoseStep]:
        return [step for step in _find_steps(self.motions, self._least) if _is_significant(step)]

    def step_before(self, photo: int) -> _PoseStep | None:
        cut = int(np.searchsorted(self.photos, photo))
        edges = [
            0,
            *(step.at for step in self.significant_steps if abs(step.at - cut) > _MAX_PHOTOS_PER_EVENT),
            len(self.photos),
        ]
        low = max(edge for edge in edges if edge <= cut)
        high = min(edge for edge in edges if edge >= cut)
        if cut - low < _MIN_SAMPLES or high - cut < _MIN_SAMPLES:
            return None
        return _pose_step_at(self.motions[low:high], cut - low, _series_noise(self.motions, self._least))

    @property
    def camera_never_rests(self) -> bool:
        shaken = float(np.median(_series_noise(self.motions, self._least) / self._least))
        steps = len(self.significant_steps)
        return shaken > _HANDHELD_NOISE_RATIO or (steps > 1 and steps * _MIN_PHOTOS_PER_STEP > len(self.photos))

    def T_base_in_cam(self, motion: Array) -> Array:
        turn = rotation_from_vector(motion[:3]) @ self._board[:3, :3]
        return pose(self._board[:3, 3] + motion[3:], turn) @ self._T_base_in_board

    def base_step_sigmas(self, step: _PoseStep) -> tuple[float, float]:
        turn = float(np.linalg.norm(step.sigma[:3]))
        lever = float(np.linalg.norm(self._T_base_in_board[:3, 3]))
        return math.hypot(float(np.linalg.norm(step.sigma[3:])), lever * turn), turn


def _board_track(results: Sequence[RigInPhoto], k: int) -> _BoardTrack | None:
    photos, boards, bases, noise = [], [], [], []
    for number, result in enumerate(results):
        arm = result.arms[k]
        board = arm.detection.T_board_in_cam if arm.detection else None
        if board is None or arm.T_base_in_cam is None or arm.status != BoardStatus.OK:
            continue
        photos.append(number)
        boards.append(board)
        bases.append(arm.T_base_in_cam)
        noise.append(_photo_noise(arm))
    if len(photos) < 2 * _MIN_SAMPLES:
        return None
    return _BoardTrack(k, photos, boards, bases, np.median(noise, axis=0))


def _photo_noise(arm: ArmBasePose) -> Array:
    """Return sigmas (6,) of a board's pose, rad and m, without errors that all photos share."""
    seen = arm.detection
    least = np.array([_NOISE_TURN] * 3 + [_NOISE_SHIFT] * 3)
    if seen is None or seen.covariance is None or seen.errors_shared_by_boards is None:
        return least
    own = np.diag(seen.covariance) - np.sum(seen.errors_shared_by_boards**2, axis=1)
    noise: Array = np.maximum(np.sqrt(np.maximum(own, 0.0)), least)
    return noise


def _relative_motion(T: Array, start: Array) -> Array:
    return np.concatenate([rotation_vector(T[:3, :3] @ start[:3, :3].T), T[:3, 3] - start[:3, 3]])


def _is_significant(step: _PoseStep) -> bool:
    turn, shift = np.linalg.norm((step.after - step.before).reshape(2, 3), axis=1)
    return bool(turn >= _MIN_TURN or shift >= _MIN_SHIFT)


_TrackStep = tuple[_BoardTrack, _PoseStep]


def _group_events(found: list[_TrackStep]) -> list[list[_TrackStep]]:
    events: list[list[_TrackStep]] = []
    for track, step in sorted(found, key=lambda one: one[0].photos[one[1].at]):
        last = events[-1] if events else []
        near = last and track.photos[step.at] - last[0][0].photos[last[0][1].at] <= _MAX_PHOTOS_PER_EVENT
        if near and all(other.arm != track.arm for other, _ in last):
            last.append((track, step))
        else:
            events.append([(track, step)])
    return events


def _classify_event(
    results: Sequence[RigInPhoto], tracks: list[_BoardTrack], event: list[_TrackStep]
) -> list[DetectedMove]:
    track, step = max(event, key=lambda one: one[1].chi_squared)
    photo = int(track.photos[step.at])
    others = [(other, its) for other in tracks if other is not track and (its := other.step_before(photo)) is not None]
    if not others:
        return [_detected_move(results, track, step, photo, MovedBody.CAMERA_OR_BASE)]
    other, its = others[0]
    if other.arm not in {one.arm for one, _ in event}:
        return [_detected_move(results, track, step, photo, MovedBody.BASE)]
    if _same_relative_pose((track, step), (other, its)):
        return [_detected_move(results, track, step, photo, MovedBody.CAMERA)]
    return [_detected_move(results, *one, photo, MovedBody.SEVERAL) for one in ((track, step), (other, its))]


def _same_relative_pose(one: _TrackStep, other: _TrackStep) -> bool:
    (track_one, step_one), (track_two, step_two) = one, other
    before = invert_pose(track_one.T_base_in_cam(step_one.before)) @ track_two.T_base_in_cam(step_two.before)
    after = invert_pose(track_one.T_base_in_cam(step_one.after)) @ track_two.T_base_in_cam(step_two.after)
    motion = _relative_motion(after, before)
    (shift_one, turn_one), (shift_two, turn_two) = (
        track_one.base_step_sigmas(step_one),
        track_two.base_step_sigmas(step_two),
    )
    turn, shift = math.hypot(turn_one, turn_two), math.hypot(shift_one, shift_two)
    reach = float(np.linalg.norm(before[:3, 3]))
    return bool(
        np.linalg.norm(motion[:3]) <= max(4 * turn, _MIN_TURN)
        and np.linalg.norm(motion[3:]) <= max(4 * (shift + reach * turn), _MIN_SHIFT + reach * _MIN_TURN)
    )


def _detected_move(
    results: Sequence[RigInPhoto], track: _BoardTrack, step: _PoseStep, photo: int, what: MovedBody
) -> DetectedMove:
    before, after = track.T_base_in_cam(step.before), track.T_base_in_cam(step.after)
    shift_sigma, turn_sigma = track.base_step_sigmas(step)
    if what is MovedBody.CAMERA:
        change = invert_pose(after)[:3, 3] - invert_pose(before)[:3, 3]
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


def _series_noise(series: Array, minimum: Array) -> Array:
    jumps = np.abs(np.diff(series, axis=0))
    sigma: Array = np.maximum(_SIGMA_PER_MAD * np.median(jumps, axis=0) / np.sqrt(2), minimum)
    return sigma


def _find_steps(series: Array, minimum: Array) -> list[_PoseStep]:
    """Return the steps of a series (n, d) with noise of at least `minimum` (d,), in order.

    Levels are medians of at least four samples: one outlier is no step.
    """
    sigma = _series_noise(series, minimum)
    edges = [0, *sorted(_split_at_steps(series / sigma, 0)), len(series)]
    steps = []
    for low, at, high in zip(edges, edges[1:], edges[2:], strict=False):
        step = _pose_step_at(series[low:high], at - low, sigma)
        if step.chi_squared > _MIN_STRENGTH:
            steps.append(replace(step, at=at))
    return steps


def _pose_step_at(series: Array, at: int, sigma: Array) -> _PoseStep:
    before, after = np.median(series[:at], axis=0), np.median(series[at:], axis=0)
    spread = sigma * np.sqrt(_MEDIAN_VARIANCE_RATIO * (1 / at + 1 / (len(series) - at)))
    return _PoseStep(at, before, after, spread, float(np.sum(((after - before) / spread) ** 2)))


def _split_at_steps(series: Array, start: int) -> list[int]:
    """Return `start` plus the steps, by recursive splits into two levels with noise 1."""
    n = len(series)
    if n < 2 * _MIN_SAMPLES:
        return []
    costs = [
        _constant_fit_cost(series[:k]) + _constant_fit_cost(series[k:])
        for k in range(_MIN_SAMPLES, n - _MIN_SAMPLES + 1)
    ]
    at = _MIN_SAMPLES + int(np.argmin(costs))
    if _pose_step_at(series, at, np.ones(series.shape[1])).chi_squared <= _MIN_STRENGTH:
        return []
    return [*_split_at_steps(series[:at], start), start + at, *_split_at_steps(series[at:], start + at)]


def _constant_fit_cost(series: Array) -> float:
    return float(np.minimum(np.abs(series - np.median(series, axis=0)), _MAX_SAMPLE_COST).sum())
