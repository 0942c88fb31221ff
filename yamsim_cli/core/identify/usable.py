"""Whether a log can tell how an arm moves: what is refused before anything is fitted, and what to record instead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..geometry.se3 import Array
from .plant import Log

# Shorter logs tell too little, s.
SHORTEST = 10.0
# How far each joint has to go at least, rad, how often it has to turn back, and how fast it has to be now and then,
# rad/s.
_SPAN, _TURNS, _SPEED = 0.1, 4, 0.15
# A joint has turned back once it went back by so much, rad.
_BACK = 0.02
# A speed is taken over so long, s, and has to be reached in this part of the log.
_OVER, _NOW_AND_THEN = 0.1, 0.05
# What records it all.
_REMEDY = "`yamsim excite` writes a motion that shows all of it"


def check_usable(logs: Sequence[Log], names: Sequence[str], side: str = "") -> None:
    """Refuse logs in which a joint does not do what tells its parameters.

    Args:
        names: of the joints.
        side: of the arm, where there are two.

    Raises:
        DatasetError: the logs are too short, or a joint hardly moves, never turns back or is always slow; the message
            names the joint and what to record.
    """
    where = ", ".join(log.name for log in logs)
    whose = f"{side} " if side else ""
    seconds = sum(log.seconds for log in logs)
    if seconds < SHORTEST:
        raise DatasetError(
            f"{where}: {seconds:.1f} s tell too little of the arm; record at least {SHORTEST:g} s, better 60; {_REMEDY}"
        )
    for k, name in enumerate(names):
        known = [(log, rows) for log in logs if (rows := _known(log)).sum() > 2]
        # What a joint is told counts too: others shake one that is told to do nothing.
        for paths in (
            [(log.times[rows], log.joints[rows, k]) for log, rows in known],
            [(log.times, log.commands[:, k]) for log, _ in known],
        ):
            if fault := _fault(paths):
                raise DatasetError(f"{where}: {whose}{name} {fault}; {_REMEDY}")


def _known(log: Log) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(log.joints).all(axis=1))


def _fault(paths: Sequence[tuple[Array, Array]]) -> str | None:
    """What a joint does not do, and what it has to; None if it does all."""
    span = max((float(np.ptp(path)) for _, path in paths), default=0.0)
    if span < _SPAN:
        return (
            f"hardly moves: it goes {span:.3f} rad, and its friction, damping and inertia show from {_SPAN} rad on; "
            "record it swinging to and fro by 0.5 rad, slowly and quickly"
        )
    turns = sum(_turns(path) for _, path in paths)
    if turns < _TURNS:
        times = "never turns back" if not turns else f"turns back only {'once' if turns == 1 else f'{turns} times'}"
        return (
            f"{times}, so that friction cannot be told from an offset or from weight; record it swinging to and fro at "
            f"least {_TURNS} times"
        )
    speeds = np.concatenate([_speeds(times, path) for times, path in paths])
    fast = float(np.quantile(speeds, 1 - _NOW_AND_THEN))
    if fast < _SPEED:
        return (
            f"is always slow: {fast:.3f} rad/s at most but for moments, where damping and inertia show from {_SPEED} "
            "rad/s on; record quicker swings too, of 1 rad/s"
        )
    return None


def _turns(path: Array) -> int:
    """How often a joint turns back, by more than it trembles."""
    turns, way, furthest = 0, 0, float(path[0])
    for place in path:
        if way == 0:
            way = int(np.sign(place - furthest)) if abs(place - furthest) > _BACK else 0
            furthest = float(place) if way else furthest
        elif way * (place - furthest) > 0:
            furthest = float(place)
        elif way * (furthest - place) > _BACK:
            turns, way, furthest = turns + 1, -way, float(place)
    return turns


def _speeds(times: Array, path: Array) -> Array:
    grid = np.arange(0, times[-1] - times[0], _OVER) + times[0]
    found: Array = np.abs(np.diff(np.interp(grid, times, path))) / _OVER
    return found
