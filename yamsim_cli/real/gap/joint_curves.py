"""Joint curves on a uniform time grid: speeds, delays, phases of motion, rest and stops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.se3 import Array

RESAMPLING_STEP = 0.002  # s, spacing of the grid
_MIN_WINDOW, _MIN_SAMPLES = 0.12, 4  # s and samples of a parabola whose slope is a speed

_MIN_DELAY, _MAX_DELAY = -0.1, 0.5  # s; delays at either end are rejected
_MIN_CORRELATION = 0.5  # correlation of speeds; below, no delay is determined
_MIN_SPEED = 0.02  # RMS, rad/s or m/s; below, no delay is determined

_STILL_SPEED = 0.02  # rad/s; slower joints are still
_MAX_CRUISING_SPEED_CHANGE = 1.0  # 1/s; a cruising joint's speed changes by less than this share per s
_SETTLING_SECONDS = 0.3  # s of stillness before a joint is at rest
# A command stops if it moves _MIN_MOVE (rad) within _MOVE_SECONDS (s), then stays _MIN_HOLD (s).
_MIN_MOVE, _MOVE_SECONDS, _MIN_HOLD = 0.02, 0.3, 0.3
_WATCHED_SECONDS, _END_SECONDS = (
    1.0,
    0.1,
)  # s after a stop to measure overshoot, and s at their end for the value at rest


@dataclass(frozen=True)
class SmoothCurves:
    """Curves on a uniform grid, with derivatives of a parabola fitted around each time.

    Attributes:
        times: (n,), s.
        values: (n, k), with `speeds` and `accelerations` per s and s2.
        smoothing_window: extent of each parabola, s.
    """

    times: Array
    values: Array
    speeds: Array
    accelerations: Array
    smoothing_window: float


def resample_and_smooth(times: Array, values: Array, *, steps: bool = False, like: Array | None = None) -> SmoothCurves:
    """Resample values (m, k) at times (m,), s, on a uniform grid, without rows that are not finite.

    Args:
        steps: values hold until the next, as commands do, instead of linear interpolation.
        like: times whose spacing sets the parabolas' extent, to smooth two curves equally.
    """
    known = np.isfinite(values).all(axis=1)
    at, rows = times[known], values[known]
    grid = np.arange(times[0], times[-1] + RESAMPLING_STEP / 2, RESAMPLING_STEP)
    if steps:
        even = rows[np.clip(np.searchsorted(at, grid + RESAMPLING_STEP / 1000, side="right") - 1, 0, None)]
    else:
        even = np.column_stack([np.interp(grid, at, column) for column in rows.T])
    spaced = at if like is None else like
    between = float(np.median(np.diff(spaced))) if len(spaced) > 1 else RESAMPLING_STEP
    half = max(2, round(max(_MIN_WINDOW, _MIN_SAMPLES * between) / 2 / RESAMPLING_STEP))
    speeds, accelerations = _parabola_derivatives(even, half)
    return SmoothCurves(grid, even, speeds, accelerations, 2 * half * RESAMPLING_STEP)


def _parabola_derivatives(rows: Array, half: int) -> tuple[Array, Array]:
    offsets = np.arange(-half, half + 1) * RESAMPLING_STEP
    _, slope, bend = np.linalg.pinv(np.vander(offsets, 3, increasing=True))
    # Each end is extended by its last `half` samples, rotated by 180 degrees about the end sample. A mirror image would
    # reverse the slope.
    reach = np.clip(np.arange(half, 0, -1), 0, len(rows) - 1)
    before = 2 * rows[0] - rows[reach]
    after = 2 * rows[-1] - rows[-1 - reach[::-1]]
    padded = np.vstack([before, rows, after])

    def convolve_columns(kernel: Array) -> Array:
        return np.column_stack([np.convolve(column, kernel[::-1], mode="valid") for column in padded.T])

    return convolve_columns(slope), 2 * convolve_columns(bend)


def estimate_delay(first: SmoothCurves, second: SmoothCurves, columns: slice | int) -> float | None:
    """Return the delay of the second motion after the first, s, by cross-correlation of speeds.

    `columns` are joints. Offsets and gains do not matter. None if a motion is too slow or the correlation too low.
    """
    one, other = (np.atleast_2d(curves.speeds.T[columns]) for curves in (first, second))
    if min(np.sqrt(np.mean(one**2)), np.sqrt(np.mean(other**2))) < _MIN_SPEED:
        return None
    low, high = round(_MIN_DELAY / RESAMPLING_STEP), round(_MAX_DELAY / RESAMPLING_STEP)
    high = min(high, one.shape[1] // 2)
    low = max(low, -(one.shape[1] // 4))
    shares = np.array([_lagged_correlation(one, other, lag) for lag in range(low, high + 1)])
    best = int(np.argmax(shares))
    if shares[best] < _MIN_CORRELATION or best in (0, len(shares) - 1):
        return None
    before, here, after = shares[best - 1 : best + 2]
    bend = before - 2 * here + after
    between = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float((low + best + between) * RESAMPLING_STEP)


def _lagged_correlation(one: Array, other: Array, lag: int) -> float:
    """Return the correlation of `one` (k, n) with `other` (k, n) moved `lag` steps earlier."""
    n = one.shape[1]
    a, b = (one[:, : n - lag], other[:, lag:]) if lag >= 0 else (one[:, -lag:], other[:, : n + lag])
    scale = np.sqrt(np.vdot(a, a) * np.vdot(b, b))
    return float(np.vdot(a, b) / scale) if scale > 0 else 0.0


class MotionPhase(StrEnum):
    """Phase of a joint's motion, by speed and its change."""

    STILL = "still"
    ACCELERATING = "accelerating"
    CRUISING = "cruising"
    BRAKING = "braking"


PHASES = tuple(MotionPhase)


def motion_phases(measured: SmoothCurves, times: Array) -> NDArray[np.int8]:
    """Return each joint's index into `PHASES` (n, dof) at times (n,), s."""
    speeds, bends = (
        np.column_stack([np.interp(times, measured.times, column) for column in rows.T])
        for rows in (measured.speeds, measured.accelerations)
    )
    fast = np.abs(speeds)
    rates = bends * np.sign(speeds) / np.maximum(fast, _STILL_SPEED)
    found = np.full(speeds.shape, PHASES.index(MotionPhase.CRUISING), np.int8)
    found[rates > _MAX_CRUISING_SPEED_CHANGE] = PHASES.index(MotionPhase.ACCELERATING)
    found[rates < -_MAX_CRUISING_SPEED_CHANGE] = PHASES.index(MotionPhase.BRAKING)
    found[fast < _STILL_SPEED] = PHASES.index(MotionPhase.STILL)
    return found


def joints_at_rest(measured: SmoothCurves, commanded: SmoothCurves) -> NDArray[np.bool_]:
    """Return the mask (n, dof) where neither joint nor command moved for the last 0.3 s."""
    still = (np.abs(measured.speeds) < _STILL_SPEED) & (np.abs(commanded.speeds) < _STILL_SPEED)
    moved = np.where(still, measured.times[0], measured.times[:, None])
    since = measured.times[:, None] - np.maximum.accumulate(moved, axis=0)
    found: NDArray[np.bool_] = still & (since >= _SETTLING_SECONDS)
    return found


@dataclass(frozen=True)
class CommandStop:
    """The span after a joint's command has stopped: grid indices for the overshoot, `end` exclusive.

    `direction` is 1 if the command came from below, -1 from above.
    """

    begin: int
    end: int
    direction: float


def find_command_stops(commanded: SmoothCurves, joint: int) -> Iterator[CommandStop]:
    """Yield a command's stops: moves of at least 0.02 rad, then 0.3 s or more of rest."""
    step = float(commanded.times[1] - commanded.times[0]) if len(commanded.times) > 1 else 1.0
    moving = np.abs(commanded.speeds[:, joint]) >= _STILL_SPEED
    changes = np.flatnonzero(np.diff(moving.astype(np.int8)))
    ends = [int(k) + 1 for k in changes if moving[k]]
    back, smeared = round(_MOVE_SECONDS / step), round(commanded.smoothing_window / 2 / step)
    for end in ends:
        again = next((int(k) + 1 for k in changes if k >= end and not moving[k]), len(moving))
        if (again - end) * step < _MIN_HOLD:
            continue
        values = commanded.values[:, joint]
        moved = values[min(end, len(values) - 1)] - values[max(0, end - back)]
        if abs(moved) >= _MIN_MOVE:
            # Smoothing delays a stop by half a parabola.
            yield CommandStop(
                max(0, end - smeared), min(again, end + round(_WATCHED_SECONDS / step)), float(np.sign(moved))
            )


def overshoot_after_stop(values: Array, stop: CommandStop) -> float:
    """Return the largest overshoot, at least 0, of values (n,) beyond their rest after a stop."""
    watched = values[stop.begin : stop.end]
    rest = float(np.mean(watched[-max(1, round(_END_SECONDS / RESAMPLING_STEP)) :]))
    return max(0.0, float(np.max(stop.direction * (watched - rest))))
