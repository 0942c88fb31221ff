"""Estimate the pose uncertainty from prints that are not flat and from misplaced markers.

The pose's least squares include linear modes of the print's shape: bow along x and y, twist, a crease. Each shape
hypothesis has Gaussian priors on its modes; their mixture has a heavy tail. A Schur complement marginalizes the modes
and the in-plane positions and size of markers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.se3 import Array

_BOW_MODES = 3  # bow along x, bow along y, twist
_FLAT_PLATE_SIGMA = 1e-4  # m, sigma of bow or twist at the edge, for paper glued to a rigid plate
_BENT_PLATE_SIGMA = 1e-3  # m, the same for a bent plate or loose paper
_FOLD_SIGMA = math.radians(4.0)  # rad, sigma of a crease's fold angle; users notice larger folds
_BENT_PROBABILITY = 0.02  # prior of a bent print
CREASE_PROBABILITY = 0.08  # prior of a creased print
# With this value, poses from 180 photos of creased prints are within their 95 % intervals.
_NONLINEAR_FOLD_SHARE = 0.15  # sigma of the linear crease modes' error, as a share of the fold angle
_CREASE_DIRECTIONS = 8  # directions of the folded side over 360 degrees; either side of a crease may lie on the plate
_CREASE_OFFSETS = (-0.5, -0.25, 0.0, 0.25, 0.5)  # positions from the centre, half widths of the print
_HEIGHT_MODES = _BOW_MODES + _CREASE_DIRECTIONS * len(_CREASE_OFFSETS)
# Rounding to a pixel has a uniform error: a sigma of 0.042 mm / sqrt(12) = 0.012 mm at 600 dpi, and of 0.030 mm for a
# 94 mm board drawn 900 px wide (244 dpi).
_PLACEMENT_SIGMA = 3e-5  # m, in-plane position of a marker column or row, and half the marker edge


@dataclass(frozen=True)
class ShapedPose:
    """A pose with the print's shape marginalized.

    Attributes:
        step: (p,) from the flat print's parameters to the expected ones.
        covariance: (p, p).
        by_fixed_parameters: (p, h) derivatives of the fitted parameters by those kept fixed.
        neglected_variance: variance of the rotation, rad^2 per axis, that linear crease modes neglect.
        flat: probability of a print on a rigid plate.
    """

    step: Array
    covariance: Array
    by_fixed_parameters: Array
    neglected_variance: float
    flat_probability: float


def shape_modes(board: Board, at: Array) -> Array:
    """Return heights (n, m) of points (n, 2) on a board, m, per unit of each mode: bows in m, creases in rad."""
    half = max(board.width, board.height) / 2
    u, v = (at / half).T
    modes = [u**2 - 1 / 3, v**2 - 1 / 3, u * v]
    for angle in np.arange(_CREASE_DIRECTIONS) * 2 * math.pi / _CREASE_DIRECTIONS:
        along = u * math.cos(angle) + v * math.sin(angle)
        modes += [half * np.maximum(0.0, along - place) for place in _CREASE_OFFSETS]
    return np.column_stack(modes)


def placement_modes(board: Board, at: Array) -> tuple[Array, Array]:
    """Return shifts of points (n, 2) along x (n, m) and y (n, m), per metre of each mode.

    Printers and drawing programs round all markers of a column or row equally, and all half edges equally. Without the
    latter mode, marker sizes would determine the scale, which positions determine better.
    """
    step, middle = board.marker_length + board.gap, np.array([board.columns - 1, board.rows - 1]) / 2
    to_right_and_down = np.array([1.0, -1.0])
    place = np.round(at / step * to_right_and_down + middle)
    from_marker = at - (place - middle) * step * to_right_and_down
    larger = from_marker / (board.marker_length / 2)
    in_column, in_row = place[:, :1] == np.arange(board.columns), place[:, 1:] == np.arange(board.rows)
    return (
        np.column_stack([in_column, np.zeros_like(in_row), larger[:, 0]]),
        np.column_stack([np.zeros_like(in_column), in_row, larger[:, 1]]),
    )


def mode_count(board: Board) -> int:
    """Return the number of shape and placement modes."""
    return _HEIGHT_MODES + board.columns + board.rows + 1


def _shape_hypotheses(
    boards: Sequence[Board], parameters: int, creased: float
) -> list[tuple[list[int], list[float], float]]:
    counts = [mode_count(board) for board in boards]
    firsts = [parameters - sum(counts[piece:]) for piece in range(len(boards))]
    bows = [first + k for first in firsts for k in range(_BOW_MODES)]
    creases = [first + k for first in firsts for k in range(_BOW_MODES, _HEIGHT_MODES)]
    places = [first + k for first, modes in zip(firsts, counts, strict=True) for k in range(_HEIGHT_MODES, modes)]
    always, placement = [*places, *bows], [_PLACEMENT_SIGMA] * len(places)
    flat, bent = ([*placement, *[sag] * len(bows)] for sag in (_FLAT_PLATE_SIGMA, _BENT_PLATE_SIGMA))
    folded = [([*always, crease], [*flat, _FOLD_SIGMA], creased / len(creases)) for crease in creases]
    return [(always, flat, 1 - _BENT_PROBABILITY - creased), (always, bent, _BENT_PROBABILITY), *folded]


def marginalize_modes(
    normal: Array,
    right_hand_side: Array,
    variance: float,
    free: list[int],
    held: list[int],
    boards: Sequence[Board],
    creased: float,
) -> ShapedPose:
    """Marginalize the shape and placement modes, the last parameters, out of the equations.

    Args:
        normal, right_hand_side: (k, k) and (k,), from residuals of variance `variance`.
        free: indices of the fitted parameters.
        held: indices of the parameters kept fixed.
        creased: prior probability of a creased print.

    Raises:
        LinAlgError: the pixels do not determine the parameters.
    """
    count = len(free)
    steps, covariances, moves, evidence, folds = [], [], [], [], []
    for modes, sigmas, share in _shape_hypotheses(boards, len(right_hand_side), creased):
        every, prior = [*free, *modes], np.array([0.0] * count + sigmas)
        precision: NDArray[np.float64] = np.divide(1.0, prior**2, out=np.zeros_like(prior), where=prior > 0)
        A = normal[np.ix_(every, every)] / variance + np.diag(precision)
        scale = 1 / np.sqrt(np.diag(A))
        inverse = np.linalg.inv(A * np.outer(scale, scale)) * np.outer(scale, scale)
        step = inverse @ right_hand_side[every] / variance
        _, log_determinant = np.linalg.slogdet(A * np.outer(scale, scale))
        log_determinant -= 2 * np.log(scale).sum()
        fit = 0.5 * float(right_hand_side[every] @ step) / variance
        evidence.append(math.log(share) + fit - 0.5 * log_determinant - np.log(prior[count:]).sum())
        steps.append(step[:count])
        of_fold = prior == _FOLD_SIGMA
        folds.append(float((step[of_fold] ** 2).sum() + np.diag(inverse)[of_fold].sum()))
        covariances.append(inverse[:count, :count])
        moves.append((-inverse @ normal[np.ix_(every, held)] / variance)[:count])
    weights = np.exp(np.array(evidence) - max(evidence))
    weights /= weights.sum()
    mean = np.einsum("h,hp->p", weights, steps)
    off = np.array(steps) - mean
    covariance = np.einsum("h,hpq->pq", weights, covariances) + np.einsum("h,hp,hq->pq", weights, off, off)
    neglected = _NONLINEAR_FOLD_SHARE**2 * float(weights @ folds)
    return ShapedPose(mean, covariance, np.einsum("h,hpk->pk", weights, moves), neglected, float(weights[0]))
