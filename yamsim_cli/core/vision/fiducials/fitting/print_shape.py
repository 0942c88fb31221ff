"""How far a print may lie out of its plane, and what that leaves open of its pose.

The print's shape is linearized in the same least squares as the pose: bow along x and y, twist, and a crease. Each
shape hypothesis has a Gaussian prior on its modes, and a mixture of hypotheses makes the prior's tail broad. Their
evidence comes from the residuals, and each one's modes are marginalized with a Schur complement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry.board import Board
from ....geometry.se3 import Array

_BOW_MODES = 3  # bow along x, bow along y, twist
_PLATE_SAG = 1e-4  # m, sigma of a bow or twist at the print's edge: paper glued to a rigid plate
_BENT_SAG = 1e-3  # m, sigma of the same where the plate is bent or the paper lies loose
_FOLD = math.radians(4.0)  # rad, sigma of a crease's fold angle: paper folded more is seen to be
_BENT_SHARE = 0.02  # prior probability of a bent print
CREASED_SHARE = 0.08  # prior probability of a creased print
_NEGLECTED = 0.15  # of the fold angle, sigma of what linear modes neglect: 180 creased photos stay in their intervals
_CREASE_ANGLES = 8  # directions of the folded side, over a whole turn: either side of a crease may lie on the plate
_CREASE_PLACES = (-0.5, -0.25, 0.0, 0.25, 0.5)  # of half the print's width, from its centre


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


def mode_count() -> int:
    """Return how many modes a piece's print has."""
    return _BOW_MODES + _CREASE_ANGLES * len(_CREASE_PLACES)


def marginalized(
    normal: Array, gradient: Array, variance: float, free: list[int], held: list[int], pieces: int, creased: float
) -> ShapedPose:
    """Marginalize the shape modes, which are the last of all parameters, out of normal equations.

    Args:
        normal, gradient: (k, k) and (k,), of residuals that are not yet divided by their `variance`.
        free: places of the parameters that are sought.
        held: places of those that are not.
        pieces: how many prints, each with all modes.
        creased: prior probability of a creased print.

    Raises:
        LinAlgError: the pixels do not determine the parameters.
    """
    modes, count = mode_count(), len(free)
    first = len(gradient) - pieces * modes
    bows = [first + piece * modes + k for piece in range(pieces) for k in range(_BOW_MODES)]
    creases = [first + piece * modes + k for piece in range(pieces) for k in range(_BOW_MODES, modes)]
    hypotheses = [(bows, _PLATE_SAG, 1 - _BENT_SHARE - creased), (bows, _BENT_SAG, _BENT_SHARE)]
    hypotheses += [([*bows, crease], _PLATE_SAG, creased / len(creases)) for crease in creases]
    steps, covariances, moves, evidence, folds = [], [], [], [], []
    for shape, sag, share in hypotheses:
        every = [*free, *shape]
        prior = np.zeros(len(every))
        prior[count : count + len(bows)] = sag
        prior[count + len(bows) :] = _FOLD
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
        first_fold = count + len(bows)
        folds.append(float((step[first_fold:] ** 2).sum() + np.trace(inverse[first_fold:, first_fold:])))
        covariances.append(inverse[:count, :count])
        moves.append((-inverse @ normal[np.ix_(every, held)] / variance)[:count])
    weights = np.exp(np.array(evidence) - max(evidence))
    weights /= weights.sum()
    mean = np.einsum("h,hp->p", weights, steps)
    off = np.array(steps) - mean
    covariance = np.einsum("h,hpq->pq", weights, covariances) + np.einsum("h,hp,hq->pq", weights, off, off)
    neglected = _NEGLECTED**2 * float(weights @ folds)
    return ShapedPose(mean, covariance, np.einsum("h,hpk->pk", weights, moves), neglected, float(weights[0]))
