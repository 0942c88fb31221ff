"""By how much one motion comes after another, by their cross-correlation."""

from __future__ import annotations

import numpy as np

from ..geometry.se3 import Array
from .smoothing import STEP, Smooth

# Delays that are looked for, s. One at either end is none that was found.
EARLIEST, LATEST = -0.1, 0.5
# Where two motions have less in common than this, nothing can be said of their delay.
_LEAST_CORRELATION = 0.5
# Nor where nothing moves by this much, as the root mean square of its speed, rad/s or m/s.
_LEAST_SPEED = 0.02


def delay(first: Smooth, second: Smooth, columns: slice | int) -> float | None:
    """How much later the second motion is than the first one, s.

    Where their speeds go together best, whatever their size: neither an offset nor a gain counts. Between two steps of
    the grid it is the top of a parabola.

    Args:
        columns: which of the values, such as one joint's; several count together.

    Returns:
        None where too little moves, or the two have too little in common.
    """
    one, other = (np.atleast_2d(found.speeds.T[columns]) for found in (first, second))
    if min(np.sqrt(np.mean(one**2)), np.sqrt(np.mean(other**2))) < _LEAST_SPEED:
        return None
    low, high = round(EARLIEST / STEP), round(LATEST / STEP)
    high = min(high, one.shape[1] // 2)
    low = max(low, -(one.shape[1] // 4))
    shares = np.array([_correlation(one, other, lag) for lag in range(low, high + 1)])
    best = int(np.argmax(shares))
    if shares[best] < _LEAST_CORRELATION or best in (0, len(shares) - 1):
        return None
    before, here, after = shares[best - 1 : best + 2]
    bend = before - 2 * here + after
    between = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float((low + best + between) * STEP)


def _correlation(one: Array, other: Array, lag: int) -> float:
    """How well `other` (k, n), `lag` steps earlier, goes with `one`, -1..1."""
    n = one.shape[1]
    a, b = (one[:, : n - lag], other[:, lag:]) if lag >= 0 else (one[:, -lag:], other[:, : n + lag])
    scale = np.sqrt(np.vdot(a, a) * np.vdot(b, b))
    return float(np.vdot(a, b) / scale) if scale > 0 else 0.0
