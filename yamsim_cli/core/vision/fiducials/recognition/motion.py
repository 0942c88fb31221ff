"""How a photo is smeared where a board is supposed to be, roughly: where to start a fit from."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ....geometry.se3 import Array
from ..fitting.print_view import PrintView, draw_print
from ..fitting.smear import Smear

# Blurs (sigma, px) and straight motions (px, with a blur beside them) that are tried.
_BLURS = (0.9, 2.0, 3.5)
_LENGTHS, _DIRECTIONS, _BLUR_MOVING = (4.0, 8.0, 12.0), 8, 1.0
# Motion is believed where it leaves less than this share of what blur alone leaves unexplained.
_BETTER = 0.85
# Pixels that the longest motion leaves out are left out for all, so that all are compared on the same ones.
_COMPARED = Smear(_BLURS[1])


def likely_smear(view: PrintView, plane: Array) -> Smear | None:
    """The smear, px, with which a print at a supposed place explains the photo best; None where too little is seen.

    Args:
        plane: where the print lies, as for `draw_print`.
    """
    drawing = draw_print(view, plane, _COMPARED.in_larger_pixels(view.coarser))
    use = drawing.marker >= 0
    if use.sum() < 2 * len(view.piece.markers):
        return None
    order = np.argsort(drawing.marker[use], kind="stable")
    _, starts, which = np.unique(drawing.marker[use][order], return_index=True, return_inverse=True)
    place = np.flatnonzero(use)[order]
    seen = _less_mean(view.photo.ravel()[place], starts, which)

    def unexplained(smear: Smear) -> float:
        drawn = smear.in_larger_pixels(view.coarser).of(drawing.sharp).ravel()[place]
        shape = _less_mean(drawn, starts, which)
        power = np.add.reduceat(shape**2, starts) + 1e-9
        contrast = np.maximum(np.add.reduceat(shape * seen, starts) / power, 0.0)
        return float(((seen - contrast[which] * shape) ** 2).sum())

    blurs = {smear: unexplained(smear) for smear in map(Smear, _BLURS)}
    angles = np.arange(_DIRECTIONS) * math.pi / _DIRECTIONS
    vectors = [(length * math.cos(angle), length * math.sin(angle)) for length in _LENGTHS for angle in angles]
    motions = {smear: unexplained(smear) for smear in (Smear(_BLUR_MOVING, vector) for vector in vectors)}
    blurred, moved = min(blurs, key=lambda one: blurs[one]), min(motions, key=lambda one: motions[one])
    return moved if motions[moved] < _BETTER * blurs[blurred] else blurred


def _less_mean(values: NDArray[np.float32], starts: NDArray[np.int_], which: NDArray[np.int_]) -> Array:
    """Values (n,) less the mean of each marker's."""
    exact = values.astype(np.float64)
    less: Array = exact - (np.add.reduceat(exact, starts) / np.bincount(which))[which]
    return less
