"""The uncertainty of a pose from a print that is not flat and whose markers are misplaced.

The print's shape is linearized in the same least squares as the pose: bow along x and y, twist, and a crease. Each
shape hypothesis has a Gaussian prior on its modes, and a mixture of hypotheses makes the prior's tail broad. Their
evidence comes from the residuals, and each one's modes are marginalized with a Schur complement. So are the places of
the markers' columns and rows in the print's plane and the markers' size, under every hypothesis.
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
_PLATE_SAG = 1e-4  # m, sigma of a bow or twist at the print's edge: paper glued to a rigid plate
_BENT_SAG = 1e-3  # m, sigma of the same where the plate is bent or the paper lies loose
_FOLD = math.radians(4.0)  # rad, sigma of a crease's fold angle: larger folds are obvious to users
_BENT_SHARE = 0.02  # prior probability of a bent print
CREASED_SHARE = 0.08  # prior probability of a creased print
_NEGLECTED = 0.15  # of the fold angle, sigma of what linear modes neglect: 180 creased photos stay in their intervals
_CREASE_ANGLES = 8  # directions of the folded side, over a whole turn: either side of a crease may lie on the plate
_CREASE_PLACES = (-0.5, -0.25, 0.0, 0.25, 0.5)  # of half the print's width, from its centre
_HEIGHT_MODES = _BOW_MODES + _CREASE_ANGLES * len(_CREASE_PLACES)
# Rounding is uniform over a pixel: at 600 dots per inch, the sigma is 0.042 mm / sqrt(12) = 0.012 mm, and at the 244 of
# a board of 94 mm drawn 900 pixels wide 0.030 mm.
_PLACEMENT = 3e-5  # m, sigma of the place of a column or a row of markers in the print's plane, and of their half edge


@dataclass(frozen=True)
class ShapedPose:
    """A pose with the print's shape marginalized.

    Attributes:
        step: (p,) from the flat print's parameters to the expected ones.
        covariance: (p, p) of the parameters.
        moves: (p, h) derivatives of the parameters by the held ones.
        neglected: variance of the turn, rad^2 about each axis, that linear modes of a crease neglect.
        flat: probability that the print lies on a rigid plate.
    """

    step: Array
    covariance: Array
    moves: Array
    neglected: float
    flat: float


def shape_modes(board: Board, at: Array) -> Array:
    """Heights (n, m) above the plane of points (n, 2) on a board, m, for each mode: bows in m, creases in rad."""
    half = max(board.width, board.height) / 2
    u, v = (at / half).T
    modes = [u**2 - 1 / 3, v**2 - 1 / 3, u * v]
    for angle in np.arange(_CREASE_ANGLES) * 2 * math.pi / _CREASE_ANGLES:
        along = u * math.cos(angle) + v * math.sin(angle)
        modes += [half * np.maximum(0.0, along - place) for place in _CREASE_PLACES]
    return np.column_stack(modes)


def placement_modes(board: Board, at: Array) -> tuple[Array, Array]:
    """How far points (n, 2) on a board move along x (n, m) and along y (n, m) with each mode, per metre.

    A printer or a drawing program rounds alike the places of all markers of a column, those of a row, and the half edge
    of all markers. Without the latter, the markers' size would decide the print's scale, which places show better.
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
    """The number of a print's modes: of its height, then of its markers' placement."""
    return _HEIGHT_MODES + board.columns + board.rows + 1


def _hypotheses(boards: Sequence[Board], parameters: int, creased: float) -> list[tuple[list[int], list[float], float]]:
    """For each hypothesis, its modes' indices among all parameters, their sigmas, and its prior probability."""
    counts = [mode_count(board) for board in boards]
    firsts = [parameters - sum(counts[piece:]) for piece in range(len(boards))]
    bows = [first + k for first in firsts for k in range(_BOW_MODES)]
    creases = [first + k for first in firsts for k in range(_BOW_MODES, _HEIGHT_MODES)]
    places = [first + k for first, modes in zip(firsts, counts, strict=True) for k in range(_HEIGHT_MODES, modes)]
    always, placement = [*places, *bows], [_PLACEMENT] * len(places)
    flat, bent = ([*placement, *[sag] * len(bows)] for sag in (_PLATE_SAG, _BENT_SAG))
    folded = [([*always, crease], [*flat, _FOLD], creased / len(creases)) for crease in creases]
    return [(always, flat, 1 - _BENT_SHARE - creased), (always, bent, _BENT_SHARE), *folded]


def marginalize_modes(
    normal: Array,
    gradient: Array,
    variance: float,
    free: list[int],
    held: list[int],
    boards: Sequence[Board],
    creased: float,
) -> ShapedPose:
    """Marginalize the shape and placement modes, which are the last of all parameters, out of normal equations.

    Args:
        normal, gradient: (k, k) and (k,), of residuals that are not yet divided by their `variance`.
        free: indices of the parameters that are fitted.
        held: indices of the others.
        boards: of the prints, each with all modes.
        creased: prior probability of a creased print.

    Raises:
        LinAlgError: the pixels do not determine the parameters.
    """
    count = len(free)
    steps, covariances, moves, evidence, folds = [], [], [], [], []
    for modes, sigmas, share in _hypotheses(boards, len(gradient), creased):
        every, prior = [*free, *modes], np.array([0.0] * count + sigmas)
        precision: NDArray[np.float64] = np.divide(1.0, prior**2, out=np.zeros_like(prior), where=prior > 0)
        A = normal[np.ix_(every, every)] / variance + np.diag(precision)
        scale = 1 / np.sqrt(np.diag(A))
        inverse = np.linalg.inv(A * np.outer(scale, scale)) * np.outer(scale, scale)
        step = inverse @ gradient[every] / variance
        _, log_determinant = np.linalg.slogdet(A * np.outer(scale, scale))
        log_determinant -= 2 * np.log(scale).sum()
        fit = 0.5 * float(gradient[every] @ step) / variance
        evidence.append(math.log(share) + fit - 0.5 * log_determinant - np.log(prior[count:]).sum())
        steps.append(step[:count])
        of_fold = prior == _FOLD
        folds.append(float((step[of_fold] ** 2).sum() + np.diag(inverse)[of_fold].sum()))
        covariances.append(inverse[:count, :count])
        moves.append((-inverse @ normal[np.ix_(every, held)] / variance)[:count])
    weights = np.exp(np.array(evidence) - max(evidence))
    weights /= weights.sum()
    mean = np.einsum("h,hp->p", weights, steps)
    off = np.array(steps) - mean
    covariance = np.einsum("h,hpq->pq", weights, covariances) + np.einsum("h,hp,hq->pq", weights, off, off)
    neglected = _NEGLECTED**2 * float(weights @ folds)
    return ShapedPose(mean, covariance, np.einsum("h,hpk->pk", weights, moves), neglected, float(weights[0]))
