"""Detect moves of the camera or of an arm's base in a series of photos from one camera.

Each board's pose in the camera frame gives a series of vectors (6,). A lasting step in such a series indicates a move.
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

# Smallest reported move. An arm in front of its board shifts the estimated pose by part of this amount.
_MIN_SHIFT = 5e-4  # m
_MIN_TURN = math.radians(0.1)  # rad
# Minimum assumed standard deviation of a pose. Identical photos would give zero.
_NOISE_SHIFT = 5e-5  # m
_NOISE_TURN = math.radians(0.01)  # rad
_MAX_EVENT_SPAN = 3  # photos, largest distance between steps of two boards that count as one event
_HANDHELD_NOISE_RATIO = 8.0  # scatter of a pose over its sigma in one photo, above which the camera is hand-held
_MIN_PHOTOS_PER_STEP = 12  # photos per step; if several steps have fewer, the camera counts as hand-held

_MIN_SAMPLES = 4  # photos between two steps; with fewer, one outlier dominates their median pose
# Squared difference of the poses before and after, in variances, above which a step counts. Noise exceeds this
# limit once in 20 million (chi-squared, 6 degrees of freedom): no false step in a series of thousands.
_MIN_STRENGTH = 45.0
_MAX_SAMPLE_COST = 6.0  # standard deviations that a sample counts for at most, so that one wrong pose is no step
_SIGMA_PER_MAD = 1.4826  # ratio of the standard deviation to the median absolute deviation, of normal noise
_MEDIAN_VARIANCE_RATIO = np.pi / 2  # ratio of the variance of a median of normal samples to that of their mean


class MovedBody(StrEnum):
    """The body that moved."""

    CAMERA = "camera"
    BASE = "base"
    EITHER = "camera or base"  # one visible board does not distinguish a move of the base from a move of the camera
    SEVERAL = "several"


@dataclass(frozen=True)
class DetectedMove:
    """A move between two photos.

    Attributes:
        photo: number of the first photo after the move, among all photos.
        path: path of the first photo after the move.
        time: time of the first photo after the move, s; None if not known.
        what: the body that moved.
        arm: the arm whose base moved, or whose board shows the move.
        shift: displacement of the base's origin or of the camera, m.
        turn: rotation angle, rad.
        shift_sigma, turn_sigma: standard deviations of `shift` (m) and `turn` (rad).
        shift_in_base: (3,) displacement along the axes of the arm's base before the move, m.
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
    """The moves of the camera and of the bases in a series of photos.

    Attributes:
        moves: in the order of the photos.
        unknown: why moves cannot be detected, for users; empty if they can.
    """

    moves: tuple[DetectedMove, ...] = ()
    unknown: str = ""


def describe_move(move: DetectedMove) -> str:
    """Return a line that describes a move: the photo, the body, and the displacement."""
    by = (
        f"{move.shift * 1000:.1f} mm (sigma {move.shift_sigma * 1000:.2f}) and "
        f"{math.degrees(move.turn):.2f} degrees (sigma {math.degrees(move.turn_sigma):.3f})"
    )
    what = {
        MovedBody.CAMERA: "the camera was moved",
        MovedBody.BASE: f"the base of {move.arm} was moved",
        MovedBody.EITHER: f"the camera or the base of {move.arm} was moved (one board alone cannot show which)",
        MovedBody.SEVERAL: f"the base of {move.arm} was moved relative to the camera, and the other bases differently",
    }[move.what]
    when = f", {move.time:.2f} s" if move.time is not None else ""
    return f"{move.path} (number {move.photo}{when}): before this photo, {what} by {by}"


def find_moves(results: Sequence[RigInPhoto]) -> MoveReport:
    """Return the moves in a series of photos from a camera on a tripod or stand.

    If all boards moved by the same motion, the camera moved. If one board moved and another did not, its base moved.
    """
    arms = range(len(results[0].arms)) if results else range(0)
    tracks = [track for k in arms if (track := _track(results, k)) is not None]
    if not tracks:
        return MoveReport(unknown=f"fewer than {2 * _MIN_SAMPLES} photos have a pose from a board")
    if any(track.camera_never_rests for track in tracks):
        return MoveReport(unknown="the camera is not on a stand: it moves between all photos")
    moves: list[DetectedMove] = []
    for event in _events([(track, step) for track in tracks for step in track.steps]):
        moves += _classify_event(results, tracks, event)
    return MoveReport(tuple(sorted(moves, key=lambda move: move.photo)))


@dataclass(frozen=True)
class _PoseStep:
    """A lasting change in a series of vectors (d,). A level is the median between two steps.

    Attributes:
        at: index of the first sample after the step.
        before, after: the levels (d,) before and after the step.
        sigma: standard deviation (d,) of the difference between the levels.
        strength: squared difference in variances, summed over all axes.
    """

    at: int
    before: Array
    after: Array
    sigma: Array
    strength: float


class _BoardTrack:
    """A board's pose over time, as motions from its pose in the middle photo.

    Attributes:
        arm: index of the arm.
        photos: numbers (n,) of the photos with a pose.
        motions: (n, 6): rotations, rad, and shifts, m, along the camera's axes.
    """

    def __init__(self, arm: int, photos: list[int], boards: list[Array], bases: list[Array], minimum: Array) -> None:
        self.arm = arm
        self.photos = np.array(photos)
        self._board, self._T_base_in_board = boards[len(boards) // 2], inverse(boards[0]) @ bases[0]
        self.motions = np.array([_relative_motion(T, self._board) for T in boards])
        self._least = minimum

    @cached_property
    def steps(self) -> list[_PoseStep]:
        """The steps of the board's pose of at least `_MIN_TURN` or `_MIN_SHIFT`."""
        return [step for step in _find_steps(self.motions, self._least) if _is_significant(step)]

    def step_before(self, photo: int) -> _PoseStep | None:
        """Return the change of the median pose at a photo, significant or not; None with too few photos around it."""
        cut = int(np.searchsorted(self.photos, photo))
        edges = [0, *(step.at for step in self.steps if abs(step.at - cut) > _MAX_EVENT_SPAN), len(self.photos)]
        low = max(edge for edge in edges if edge <= cut)
        high = min(edge for edge in edges if edge >= cut)
        if cut - low < _MIN_SAMPLES or high - cut < _MIN_SAMPLES:
            return None
        return _step_at(self.motions[low:high], cut - low, _noise_of(self.motions, self._least))

    @property
    def camera_never_rests(self) -> bool:
        """Whether the camera moves almost all the time, as in a hand."""
        shaken = float(np.median(_noise_of(self.motions, self._least) / self._least))
        steps = len(self.steps)
        return shaken > _HANDHELD_NOISE_RATIO or (steps > 1 and steps * _MIN_PHOTOS_PER_STEP > len(self.photos))

    def base(self, motion: Array) -> Array:
        """Return the base's pose (4, 4) in the camera frame for a motion (6,) of the board from the middle photo."""
        turn = rotation_from_vector(motion[:3]) @ self._board[:3, :3]
        return pose(self._board[:3, 3] + motion[3:], turn) @ self._T_base_in_board

    def sigma(self, step: _PoseStep) -> tuple[float, float]:
        """Return the standard deviations of the base's shift (m) and rotation (rad) in a step, all axes together."""
        turn = float(np.linalg.norm(step.sigma[:3]))
        lever = float(np.linalg.norm(self._T_base_in_board[:3, 3]))
        return math.hypot(float(np.linalg.norm(step.sigma[3:])), lever * turn), turn


def _track(results: Sequence[RigInPhoto], k: int) -> _BoardTrack | None:
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


def _photo_noise(arm: ArmPose) -> Array:
    """Return the standard deviations (6,) of a board's pose, rad and m, without errors that all photos share."""
    seen = arm.detection
    least = np.array([_NOISE_TURN] * 3 + [_NOISE_SHIFT] * 3)
    if seen is None or seen.covariance is None or seen.shared_errors is None:
        return least
    own = np.diag(seen.covariance) - np.sum(seen.shared_errors**2, axis=1)
    noise: Array = np.maximum(np.sqrt(np.maximum(own, 0.0)), least)
    return noise


def _relative_motion(T: Array, start: Array) -> Array:
    """Return the motion (6,) from a start pose: a rotation vector, rad, and a shift, m, in the parent frame."""
    return np.concatenate([rotation_vector(T[:3, :3] @ start[:3, :3].T), T[:3, 3] - start[:3, 3]])


def _is_significant(step: _PoseStep) -> bool:
    turn, shift = np.linalg.norm((step.after - step.before).reshape(2, 3), axis=1)
    return bool(turn >= _MIN_TURN or shift >= _MIN_SHIFT)


_TrackStep = tuple[_BoardTrack, _PoseStep]


def _events(found: list[_TrackStep]) -> list[list[_TrackStep]]:
    """Group the steps of different boards that lie at most `_MAX_EVENT_SPAN` photos apart."""
    events: list[list[_TrackStep]] = []
    for track, step in sorted(found, key=lambda one: one[0].photos[one[1].at]):
        last = events[-1] if events else []
        near = last and track.photos[step.at] - last[0][0].photos[last[0][1].at] <= _MAX_EVENT_SPAN
        if near and all(other.arm != track.arm for other, _ in last):
            last.append((track, step))
        else:
            events.append([(track, step)])
    return events


def _classify_event(
    results: Sequence[RigInPhoto], tracks: list[_BoardTrack], event: list[_TrackStep]
) -> list[DetectedMove]:
    """Return the moves of an event, from the boards with a step and those without."""
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
    """Return whether the relative pose of two bases is the same before and after an event."""
    (track_one, step_one), (track_two, step_two) = one, other
    before = inverse(track_one.base(step_one.before)) @ track_two.base(step_two.before)
    after = inverse(track_one.base(step_one.after)) @ track_two.base(step_two.after)
    motion = _relative_motion(after, before)
    (shift_one, turn_one), (shift_two, turn_two) = track_one.sigma(step_one), track_two.sigma(step_two)
    turn, shift = math.hypot(turn_one, turn_two), math.hypot(shift_one, shift_two)
    reach = float(np.linalg.norm(before[:3, 3]))
    return bool(
        np.linalg.norm(motion[:3]) <= max(4 * turn, _MIN_TURN)
        and np.linalg.norm(motion[3:]) <= max(4 * (shift + reach * turn), _MIN_SHIFT + reach * _MIN_TURN)
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
    """Return the noise (d,) of a series (n, d), at least `minimum` (d,). The estimate is robust to a few steps."""
    jumps = np.abs(np.diff(series, axis=0))
    sigma: Array = np.maximum(_SIGMA_PER_MAD * np.median(jumps, axis=0) / np.sqrt(2), minimum)
    return sigma


def _find_steps(series: Array, minimum: Array) -> list[_PoseStep]:
    """Return the steps of a series (n, d), in order.

    Between two steps, the level is the median of at least four samples. A single outlier is no step.

    Args:
        minimum: minimum standard deviation (d,) of the noise.
    """
    sigma = _noise_of(series, minimum)
    edges = [0, *sorted(_split(series / sigma, 0)), len(series)]
    steps = []
    for low, at, high in zip(edges, edges[1:], edges[2:], strict=False):
        step = _step_at(series[low:high], at - low, sigma)
        if step.strength > _MIN_STRENGTH:
            steps.append(replace(step, at=at))
    return steps


def _step_at(series: Array, at: int, sigma: Array) -> _PoseStep:
    """Return the step before sample `at` of a series (n, d) whose noise has standard deviations `sigma` (d,)."""
    before, after = np.median(series[:at], axis=0), np.median(series[at:], axis=0)
    spread = sigma * np.sqrt(_MEDIAN_VARIANCE_RATIO * (1 / at + 1 / (len(series) - at)))
    return _PoseStep(at, before, after, spread, float(np.sum(((after - before) / spread) ** 2)))


def _split(series: Array, start: int) -> list[int]:
    """Return `start` plus the indices at which a series with noise 1 steps, by recursive splits into two levels."""
    n = len(series)
    if n < 2 * _MIN_SAMPLES:
        return []
    costs = [_cost(series[:k]) + _cost(series[k:]) for k in range(_MIN_SAMPLES, n - _MIN_SAMPLES + 1)]
    at = _MIN_SAMPLES + int(np.argmin(costs))
    if _step_at(series, at, np.ones(series.shape[1])).strength <= _MIN_STRENGTH:
        return []
    return [*_split(series[:at], start), start + at, *_split(series[at:], start + at)]


def _cost(series: Array) -> float:
    return float(np.minimum(np.abs(series - np.median(series, axis=0)), _MAX_SAMPLE_COST).sum())
