"""How fast joints turn, from where they were measured: by parabolas through what was measured around each moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.se3 import Array

# Of the grid that everything is put on, s.
STEP = 0.002
# How long a stretch each parabola fits at least, s, and how many samples it covers at least.
_STRETCH, _SAMPLES = 0.12, 4


@dataclass(frozen=True)
class Smooth:
    """Values on an even grid, with what a parabola around each moment says of them.

    Attributes:
        times: of the grid (n,), s.
        values: as they were, between samples interpolated (n, k).
        speeds: (n, k), per s.
        accelerations: (n, k), per s2.
        stretch: that each parabola fits, s.
    """

    times: Array
    values: Array
    speeds: Array
    accelerations: Array
    stretch: float


def smooth(times: Array, values: Array, *, steps: bool = False, like: Array | None = None) -> Smooth:
    """Values (m, k) known at some times (m,), where they are finite in all columns, on an even grid.

    Args:
        steps: whether a value stays until the next one, as a command does, rather than going there evenly.
        like: other times whose samples say how long parabolas are to be, so that two curves are smoothed alike.
    """
    known = np.isfinite(values).all(axis=1)
    at, rows = times[known], values[known]
    grid = np.arange(times[0], times[-1] + STEP / 2, STEP)
    if steps:
        even = rows[np.clip(np.searchsorted(at, grid + STEP / 1000, side="right") - 1, 0, None)]
    else:
        even = np.column_stack([np.interp(grid, at, column) for column in rows.T])
    spaced = at if like is None else like
    between = float(np.median(np.diff(spaced))) if len(spaced) > 1 else STEP
    half = max(2, round(max(_STRETCH, _SAMPLES * between) / 2 / STEP))
    speeds, accelerations = _fitted(even, half)
    return Smooth(grid, even, speeds, accelerations, 2 * half * STEP)


def _fitted(rows: Array, half: int) -> tuple[Array, Array]:
    """Slopes and bends (n, k) of the parabolas that fit best over `half` rows to either side."""
    offsets = np.arange(-half, half + 1) * STEP
    _, slope, bend = np.linalg.pinv(np.vander(offsets, 3, increasing=True))
    # Beyond the ends it goes on as if turned about them, which keeps the slope there.
    reach = np.clip(np.arange(half, 0, -1), 0, len(rows) - 1)
    before = 2 * rows[0] - rows[reach]
    after = 2 * rows[-1] - rows[-1 - reach[::-1]]
    padded = np.vstack([before, rows, after])

    def through(kernel: Array) -> Array:
        return np.column_stack([np.convolve(column, kernel[::-1], mode="valid") for column in padded.T])

    return through(slope), 2 * through(bend)


def at_times(found: Smooth, rows: Array, times: Array) -> Array:
    """Rows (n, k) of a grid as they are at other times (m,), (m, k)."""
    return np.column_stack([np.interp(times, found.times, column) for column in rows.T])
