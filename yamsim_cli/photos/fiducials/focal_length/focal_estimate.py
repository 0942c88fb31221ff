"""Estimate an uncalibrated camera's focal length from the perspective of boards in its photos.

A slanted board shrinks towards its far edge, which separates distance from focal length; a board seen straight on fits
any. So each focal length of a range gets the boards' best poses and their chi squared. The result is a 95 % interval,
or the reason why none is useful.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.least_squares import LeastSquares, solve_least_squares

from ..markers import find_markers, group_markers
from .board_outline import BoardOutline, fit_outline
from .board_poses import BoardPoses, PosesPerFocalLength, fit_board_poses, merge_rows

Grey = NDArray[np.uint8]

# Longer sides of the image: from 100 degrees field of view to lenses too long to film robots.
_FOCAL_RANGE = (0.42, 16.0)
_NODES, _REFINED_NODES = 57, 33  # focal lengths over the range, and over one valley
_MAX_LOCAL_MINIMA = 3  # local minima of chi squared to refine
_MIN_VALLEY_NODES = 14  # focal lengths within a valley, up to which it is refined
_MAX_REFINEMENTS = 6  # finer grids in a valley

_CHI_SQUARED_95 = 3.84  # chi squared of a 95 % interval, one degree of freedom
_CHI_SQUARED_VALLEY = 16.0  # chi squared above the minimum, within a valley
# Minimum sigmas, from lens effects outside the model: log focal length, principal point (focal lengths), k1. Source:
# 120 sets of five photos with distortion; rms focal errors of 0.2 and 0.3 %, of which outlines explain 0.1 %.
_MIN_SIGMAS = np.array([0.003, 0.0005, 0.0005, 0.002])
# Share of each sigma that is added independently: the valley of likely lenses is curved, a covariance straight. Source:
# outlines of 200 single photos and 70 sets of four, lenses from the prior: 62 and 84 % of squared errors are within the
# 95 % bounds without this share, 95 and 96 % with it.
_ADDED_SIGMA_SHARE = 0.5
_MAX_INTERVAL_RATIO = 1.5  # ratio of a 95 % interval's ends; above, errors are far from normal
_MAX_MISFIT_SIGMAS = 3.72  # sigmas of chi squared that 1 in 10,000 consistent sets exceeds

_TYPICAL_FOCAL = 0.5 / math.tan(math.radians(30.0))  # longer sides of the image, 60 degrees field of view
_TYPICAL_LOG_SIGMA = 0.35  # sigma of the typical focal length's logarithm

_NO_BOARD_REASON = "no board determines the focal length"
_ADVICE = "photograph the board at a slant, or give --camera"

# Lens prior, sigmas of principal point (longer sides, right and down) and k1. Source: 13 published calibrations of
# webcams and robots' cameras: half within one sigma, three in four within two. Phones correct distortion and are well
# within.
_LENS_SIGMAS = np.array([0.02, 0.02, 0.1])
_MAX_LENS_ROUNDS = 25  # steps of the lens, each with refitted poses
_MAX_ROUNDS_WITHOUT_GAIN = 2  # without gain, after which the search ends
_CHI_SQUARED_RELEVANT = 150.0  # chi squared above the minimum, from which its value is irrelevant
_MIN_GAIN = 0.03  # gain of chi squared; a round with less is idle
_CHI_SQUARED_IMPOSSIBLE = 1e12  # stands for infinite or undefined chi squared


@dataclass(frozen=True)
class FocalProfile:
    """How well each focal length explains the outlines, with its best lens.

    Attributes:
        side_over_focal_length: longer side of the image over the focal length (n,).
        misfit: chi squared (n,).
        lens: principal point shift (longer sides, right and down) and k1 (n, 3).
        lens_covariance: (n, 3, 3) at a fixed focal length.
    """

    side_over_focal_length: Array
    misfit: Array
    lens: Array
    lens_covariance: Array


def compute_profile(
    outlines: Sequence[BoardOutline], size: tuple[int, int], spread: Array, near: FocalProfile | None = None
) -> FocalProfile:
    """Return chi squared and the best lens at each focal length.

    Args:
        outlines: from all photos of one camera.
        size: width and height of the photos, px.
        spread: longer side of the image over the focal length (n,).
        near: a coarser profile with start lenses; None starts without distortion.
    """
    lens = np.zeros((len(spread), 3))
    if near is not None:
        lens = np.column_stack([np.interp(spread, near.side_over_focal_length, near.lens[:, k]) for k in range(3)])
    problem = _LensProblem([fit_board_poses(outline, size, spread) for outline in outlines])
    found = solve_least_squares(problem, problem.start_state(lens), _MAX_LENS_ROUNDS)
    assert found is not None
    state, known = found
    return FocalProfile(spread, known.cost, state.lens, known.lens_covariance())


@dataclass(frozen=True)
class _LensState:
    lens: Array
    poses: tuple[tuple[PosesPerFocalLength, ...], ...]


@dataclass(frozen=True)
class _LensEquations:
    """Normal equations of the lens at n focal lengths, from boards at their best poses.

    `half_hessian` (n, 3, 3) and `half_gradient` (n, 3) are half the Hessian and gradient of chi squared `misfit` (n,)
    by `lens` (n, 3), without the prior.
    """

    half_hessian: Array
    half_gradient: Array
    misfit: Array
    lens: Array

    def __add__(self, other: _LensEquations) -> _LensEquations:
        return _LensEquations(
            self.half_hessian + other.half_hessian,
            self.half_gradient + other.half_gradient,
            self.misfit + other.misfit,
            self.lens,
        )

    @classmethod
    def from_board(cls, board: BoardPoses, poses: PosesPerFocalLength, lens: Array) -> _LensEquations:
        """Return one board's equations, with what its pose could explain projected out."""
        residual, by_pose, by_lens = board.linearized_residuals(poses, lens)
        q, _ = np.linalg.qr(by_pose)
        own = by_lens - q @ (np.swapaxes(q, 1, 2) @ by_lens)
        left = residual - (q @ (np.swapaxes(q, 1, 2) @ residual[..., None]))[..., 0]
        return cls(np.swapaxes(own, 1, 2) @ own, np.einsum("nij,ni->nj", own, left), (left**2).sum(axis=1), lens)

    @property
    def cost(self) -> Array:
        cost: Array = self.misfit + (self.lens**2 / _LENS_SIGMAS**2).sum(axis=1)
        return np.where(np.isfinite(cost), cost, _CHI_SQUARED_IMPOSSIBLE)

    @property
    def normal_matrix(self) -> Array:
        return np.nan_to_num(self.half_hessian) + np.diag(_LENS_SIGMAS**-2.0)

    @property
    def right_hand_side(self) -> Array:
        return -np.nan_to_num(self.half_gradient + _LENS_SIGMAS**-2.0 * self.lens)

    def lens_covariance(self) -> Array:
        return np.linalg.inv(self.normal_matrix).astype(np.float64)


class _LensProblem(LeastSquares[_LensState, _LensEquations]):
    """Least squares over the lens at each focal length; poses are refitted for each lens."""

    def __init__(self, boards: Sequence[Sequence[BoardPoses]]) -> None:
        self._boards = boards
        self._idle = 0

    def start_state(self, lens: Array) -> _LensState:
        return self._refined_state(lens, [[board.initial_poses for board in pair] for pair in self._boards])

    def _refined_state(self, lens: Array, poses: Sequence[Sequence[PosesPerFocalLength]]) -> _LensState:
        pairs = zip(self._boards, poses, strict=True)
        return _LensState(
            lens, tuple(tuple(b.refine_poses(p, lens) for b, p in zip(*pair, strict=True)) for pair in pairs)
        )

    def linearize(self, state: _LensState, before: _LensEquations | None) -> _LensEquations:
        taken = []
        for boards, poses in zip(self._boards, state.poses, strict=True):
            one, two = (_LensEquations.from_board(b, p, state.lens) for b, p in zip(boards, poses, strict=True))
            taken.append(merge_rows(one.misfit <= np.nan_to_num(two.misfit, nan=_CHI_SQUARED_IMPOSSIBLE), one, two))
        return functools.reduce(_LensEquations.__add__, taken)

    def apply_step(self, state: _LensState, step: Array) -> _LensState:
        return self._refined_state(state.lens + step, state.poses)

    def is_converged(self, state: _LensState, known: _LensEquations, step: Array, gain: Array) -> bool:
        matters = known.cost < known.cost.min() + _CHI_SQUARED_RELEVANT
        self._idle = 0 if (gain[matters] > _MIN_GAIN).any() else self._idle + 1
        return self._idle == _MAX_ROUNDS_WITHOUT_GAIN

    def select_better(
        self,
        better: NDArray[np.bool_],
        there: tuple[_LensState, _LensEquations],
        here: tuple[_LensState, _LensEquations],
    ) -> tuple[_LensState, _LensEquations]:
        poses = tuple(
            tuple(merge_rows(better, new, old) for new, old in zip(*pair, strict=True))
            for pair in zip(there[0].poses, here[0].poses, strict=True)
        )
        lens = np.where(better[:, None], there[0].lens, here[0].lens)
        return _LensState(lens, poses), merge_rows(better, there[1], here[1])


@dataclass(frozen=True)
class FocalEstimate:
    """A focal length estimated from photos.

    Attributes:
        camera: the likeliest, or one of 60 degrees field of view with a `reason`.
        low, high: ends of the 95 % interval, px; None for an open end.
        reason: why the estimate is too poor for poses, for users; empty if useful.
    """

    camera: CameraModel
    low: float | None
    high: float | None
    reason: str = ""


def known_focal(camera: CameraModel) -> FocalEstimate:
    """Return a calibrated camera's focal length, with the 95 % interval from `focal_sigma`."""
    wide = math.exp(math.sqrt(_CHI_SQUARED_95) * camera.focal_sigma)
    return FocalEstimate(camera, camera.mean_focal_length / wide, camera.mean_focal_length * wide)


def find_outlines(grey: Grey, boards: Sequence[Board]) -> list[BoardOutline]:
    """Return the outlines of boards in a photo (height, width) from an unknown camera."""
    height, width = grey.shape
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    camera = CameraModel.from_focal_length(width, height, float(max(width, height)))
    found, photo = [], None
    for board in boards:
        for group in group_markers(markers[board.dictionary], board, camera)[:1]:
            photo = grey.astype(np.float32) if photo is None else photo
            if outline := fit_outline(photo, group, board):
                found.append(outline)
    return found


def estimate_focal(outlines: Sequence[BoardOutline], size: tuple[int, int]) -> FocalEstimate:
    """Estimate the focal length from all photos of one camera, of `size` (width, height), px."""
    width, height = size
    usual = CameraModel.from_focal_length(width, height, _TYPICAL_FOCAL * max(size), _TYPICAL_LOG_SIGMA)
    if not outlines:
        return FocalEstimate(usual, None, None, _NO_BOARD_REASON)
    found = _best_profile(
        outlines, size, compute_profile(outlines, size, np.geomspace(1 / _FOCAL_RANGE[1], 1 / _FOCAL_RANGE[0], _NODES))
    )
    low, high = _focal_interval(found, size)
    refused = _rejection_reason(found, len(outlines), low, high)
    return FocalEstimate(usual if refused else _likeliest_camera(found, size), low, high, refused)


def _best_profile(outlines: Sequence[BoardOutline], size: tuple[int, int], coarse: FocalProfile) -> FocalProfile:
    """Refine several valleys, since the grid may miss a narrow one."""
    misfit = np.pad(coarse.misfit, 1, constant_values=math.inf)
    bottoms = np.flatnonzero((misfit[1:-1] <= misfit[:-2]) & (misfit[1:-1] <= misfit[2:]))
    ends = np.isin(bottoms, (0, len(coarse.side_over_focal_length) - 1))
    # The range's ends come last, and only if no valley is far deeper.
    inner, found = bottoms[~ends], []
    for bottom in inner[np.argsort(coarse.misfit[inner])][:_MAX_LOCAL_MINIMA]:
        found.append(_refine_profile(outlines, size, coarse, int(bottom)))
    for bottom in bottoms[ends]:
        if all(coarse.misfit[bottom] < one.misfit.min() + _CHI_SQUARED_VALLEY for one in found):
            found.append(_refine_profile(outlines, size, coarse, int(bottom)))
    return min(found, key=lambda one: float(one.misfit.min()))


def _refine_profile(
    outlines: Sequence[BoardOutline], size: tuple[int, int], found: FocalProfile, best: int
) -> FocalProfile:
    for _ in range(_MAX_REFINEMENTS):
        last_node = len(found.side_over_focal_length) - 1
        likely = found.misfit < found.misfit[best] + _CHI_SQUARED_VALLEY
        # This valley, up to the first unlikely focal length on either side.
        first = best - int(np.argmin(np.append(likely[best::-1], False)))
        last = best + int(np.argmin(np.append(likely[best:], False)))
        first, last = max(first, 0), min(last, last_node)
        if last - first > _MIN_VALLEY_NODES or (first, last) == (0, last_node):
            break
        found = compute_profile(
            outlines,
            size,
            np.geomspace(found.side_over_focal_length[first], found.side_over_focal_length[last], _REFINED_NODES),
            found,
        )
        best = int(np.argmin(found.misfit))
    return found


def _focal_interval(found: FocalProfile, size: tuple[int, int]) -> tuple[float | None, float | None]:
    best = math.log(found.side_over_focal_length[np.argmin(found.misfit)])
    over = found.misfit - found.misfit.min() - _CHI_SQUARED_95
    inside = np.flatnonzero(over <= 0)
    ends: list[float | None] = []
    for edge, beyond in ((inside[-1], inside[-1] + 1), (inside[0], inside[0] - 1)):
        if not 0 <= beyond < len(over):
            ends.append(None)
            continue
        part = over[edge] / (over[edge] - over[beyond])
        log = (1 - part) * math.log(found.side_over_focal_length[edge]) + part * math.log(
            found.side_over_focal_length[beyond]
        )
        off = math.copysign(math.hypot(log - best, math.sqrt(_CHI_SQUARED_95) * _MIN_SIGMAS[0]), log - best)
        ends.append(max(size) / math.exp(best + off))
    return ends[0], ends[1]


def _rejection_reason(found: FocalProfile, boards: int, low: float | None, high: float | None) -> str:
    freedom = 2 * boards - 1
    # Wilson and Hilferty's approximation of chi squared.
    most = freedom * (1 - 2 / (9 * freedom) + _MAX_MISFIT_SIGMAS * math.sqrt(2 / (9 * freedom))) ** 3
    if found.misfit.min() > most:
        return (
            "no single focal length explains the boards: the lens distorts too much or prints are bent; give --camera"
        )
    if low is None and high is None:
        return f"any focal length explains the photo equally well: {_ADVICE}"
    if high is None:
        return f"any focal length from {low:.0f} px upwards explains the photo: {_ADVICE}"
    if low is None:
        return f"any focal length up to {high:.0f} px explains the photo: {_ADVICE}"
    if high > _MAX_INTERVAL_RATIO * low:
        return f"the focal length may be anything from {low:.0f} to {high:.0f} px: {_ADVICE}"
    return ""


def _likeliest_camera(found: FocalProfile, size: tuple[int, int]) -> CameraModel:
    width, height = size
    best = int(np.argmin(found.misfit))
    focal = max(size) / float(found.side_over_focal_length[best])
    off = -np.log(found.side_over_focal_length / found.side_over_focal_length[best])
    likely = np.exp(-0.5 * (found.misfit - found.misfit[best]))
    # About the likeliest value: the mean differs in an asymmetric valley.
    variance = float((likely * off**2).sum() / likely.sum())
    # Principal point in focal lengths.
    units = np.array([found.side_over_focal_length[best], found.side_over_focal_length[best], 1.0])
    lens = found.lens * units
    slope = (likely * off) @ (lens - lens[best]) / max(float((likely * off**2).sum()), 1e-30)
    covariance = np.zeros((4, 4))
    covariance[1:, 1:] = found.lens_covariance[best] * np.outer(units, units)
    along = np.append(1.0, slope)
    covariance += variance * np.outer(along, along)
    covariance += np.diag(_ADDED_SIGMA_SHARE**2 * np.diag(covariance) + _MIN_SIGMAS**2)
    sigma = math.hypot(math.sqrt(variance), _MIN_SIGMAS[0])
    right, down, bend = lens[best].tolist()
    cx, cy = (width - 1) / 2 + focal * right, (height - 1) / 2 + focal * down
    K = ((focal, 0.0, cx), (0.0, focal, cy), (0.0, 0.0, 1.0))
    rows = tuple(tuple(row) for row in covariance.tolist())
    return CameraModel(width, height, K, (bend, 0.0, 0.0, 0.0), sigma, rows)
