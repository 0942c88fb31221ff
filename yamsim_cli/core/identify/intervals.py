"""How surely fitted numbers are known."""

from __future__ import annotations

import numpy as np

from ..geometry.se3 import Array
from .fit import Fitted

# Errors that lie so near in time are not independent, s: friction keeps a joint on one side of its place until it
# turns.
_BLOCK = 2.5
_FEWEST_BLOCKS = 6


def half_widths(fitted: Fitted) -> Array:
    """Half the width of each parameter's interval at 95 %, (k,), in its own unit.

    Blocks of the log are taken for independent, whatever goes on in each (Huber's and White's estimate for clusters):
    what no model explains, another law of friction above all, differs from block to block as noise does, and counts.
    """
    weighted = fitted.slopes * fitted.weights[None, :, None]
    errors = fitted.errors * fitted.weights
    scale = np.array([each.scale for each in fitted.parameters])
    precision = np.diag((scale / np.array([each.spread for each in fitted.parameters])) ** 2)
    flat = weighted.reshape(-1, weighted.shape[-1])
    inverse = np.linalg.inv(flat.T @ flat + precision)
    span = fitted.times[-1] - fitted.times[0]
    blocks = max(_FEWEST_BLOCKS, round(span / _BLOCK))
    number = np.clip(((fitted.times - fitted.times[0]) / span * blocks).astype(int), 0, blocks - 1)
    scores = np.array([np.einsum("ijk,ij->k", weighted[number == k], errors[number == k]) for k in range(blocks)])
    # What was believed before counts as one more.
    spread = scores.T @ scores * blocks / (blocks - 1) + precision
    deviation = np.sqrt(np.diag(inverse @ spread @ inverse)) * scale
    found: Array = _student(blocks - 1) * deviation
    return found


def _student(freedom: int) -> float:
    """The 97.5 % quantile of Student's distribution, for 5 degrees of freedom and more.

    Source: the first terms of Cornish's and Fisher's expansion, Abramowitz and Stegun 26.7.5.
    """
    z = 1.959964
    terms = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96, (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return z + float(sum(term / freedom ** (k + 1) for k, term in enumerate(terms)))
