"""What a joint was doing when: still, accelerating, cruising or braking; where it had come to rest; and its stops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array
from .smoothing import Smooth, at_times

# A joint that turns slower is still, rad/s.
STILL_SPEED = 0.02
# A joint cruises while its speed changes by less than this share of itself in a second.
CRUISING_RATE = 1.0
# So long after it became still, a joint has come to rest, s.
SETTLING = 0.3
# A stop is a command that moved by so much in its last so many seconds, rad and s, and then stays for so long, s.
_LEAST_MOVE, _LAST, _LEAST_HOLD = 0.02, 0.3, 0.3
# What a joint does that long after a stop counts for it, s; the mean of the last part of that is where it ends, s.
_WATCHED, _END = 1.0, 0.1


class Phase(StrEnum):
    """What a joint is doing."""

    STILL = "still"
    ACCELERATING = "accelerating"
    CRUISING = "cruising"
    BRAKING = "braking"


PHASES = tuple(Phase)


def phases(measured: Smooth, times: Array) -> NDArray[np.int8]:
    """The number in `PHASES` of what each joint was doing as measured, (n, dof) at times (n,)."""
    speeds, bends = (at_times(measured, rows, times) for rows in (measured.speeds, measured.accelerations))
    fast = np.abs(speeds)
    rates = bends * np.sign(speeds) / np.maximum(fast, STILL_SPEED)
    found = np.full(speeds.shape, PHASES.index(Phase.CRUISING), np.int8)
    found[rates > CRUISING_RATE] = PHASES.index(Phase.ACCELERATING)
    found[rates < -CRUISING_RATE] = PHASES.index(Phase.BRAKING)
    found[fast < STILL_SPEED] = PHASES.index(Phase.STILL)
    return found


def at_rest(measured: Smooth, commanded: Smooth, times: Array) -> NDArray[np.bool_]:
    """Where each joint had come to rest (n, dof) at times (n,): neither it nor its command moved for a while."""
    still = (np.abs(measured.speeds) < STILL_SPEED) & (np.abs(commanded.speeds) < STILL_SPEED)
    moved = np.where(still, measured.times[0], measured.times[:, None])
    since = measured.times[:, None] - np.maximum.accumulate(moved, axis=0)
    return at_times(measured, (still & (since >= SETTLING)).astype(np.float64), times) > 0.999


@dataclass(frozen=True)
class Stop:
    """A command that came to a stop.

    Attributes:
        begin, end: rows of the grid between which a joint is watched.
        direction: 1 where it came from below, -1 from above.
    """

    begin: int
    end: int
    direction: float


def stops(commanded: Smooth, joint: int) -> Iterator[Stop]:
    """The stops of one joint's command."""
    step = float(commanded.times[1] - commanded.times[0]) if len(commanded.times) > 1 else 1.0
    moving = np.abs(commanded.speeds[:, joint]) >= STILL_SPEED
    changes = np.flatnonzero(np.diff(moving.astype(np.int8)))
    ends = [int(k) + 1 for k in changes if moving[k]]
    back, smeared = round(_LAST / step), round(commanded.stretch / 2 / step)
    for end in ends:
        again = next((int(k) + 1 for k in changes if k >= end and not moving[k]), len(moving))
        if (again - end) * step < _LEAST_HOLD:
            continue
        values = commanded.values[:, joint]
        moved = values[min(end, len(values) - 1)] - values[max(0, end - back)]
        if abs(moved) >= _LEAST_MOVE:
            # Smoothing sees a stop that much later than it is.
            yield Stop(max(0, end - smeared), min(again, end + round(_WATCHED / step)), float(np.sign(moved)))


def overshoot(values: Array, found: Stop, step: float) -> float:
    """How far values (n,) on the grid went beyond where they came to rest after a stop, 0 or more."""
    watched = values[found.begin : found.end]
    rest = float(np.mean(watched[-max(1, round(_END / step)) :]))
    return max(0.0, float(np.max(found.direction * (watched - rest))))
