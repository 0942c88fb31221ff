"""Slide flat cloth to where it is wanted: two hands take corners of it, and pull."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

from ...geometry.se3 import Array, rotation_z
from ...geometry.smoothing import height
from ..bench import Bench
from .hands import outcome
from .reach import Lay, Taken, at, reached

# Cloth is slid aside to the middle between the arms, or not, and by these ways to them, m: what is pulled by its nearer
# side comes along straight.
_NEARER = (0.1, 0.15, 0.05, 0.0, -0.05)

#: Hands that slide cloth move so fast, m/s.
SPEED = 0.2

# Cloth may be so much higher than a layer afterwards, m.
_HIGH = 0.02

# So many slides are tried in a simulation at most.
_TRIALS = 8


def slid(bench: Bench, thing: str, turns: Sequence[float], wanted: Callable[[Array], bool]) -> list[Taken] | None:
    """How two hands slide a flat cloth so that it lies as it is wanted; None where no slide does that.

    Args:
        turns: by what angles it may be turned meanwhile, rad.
        wanted: whether it would be good if a cloth's points were at (along y, along x, 3), in `world`, m.
    """
    points, trials = bench.world.points(thing), 0
    rows, columns = points.shape[:2]
    corners = [(0, 0), (0, columns - 1), (rows - 1, columns - 1), (rows - 1, 0)]
    pairs = sorted(itertools.combinations(corners, 2), key=lambda pair: sum(points[corner][0] for corner in pair))
    for slide in _slides(points, turns):
        if not wanted(slide):
            continue
        for pair in pairs:
            lays = [Lay(corner, at(slide[corner]), alone=True) for corner in pair]
            if (taken := reached(bench, thing, lays)) is None:
                continue
            after = outcome(bench, thing, taken, 0.0, SPEED)
            if height(after) < _HIGH and wanted(after):
                return taken
            trials += 1
            if trials == _TRIALS:
                return None
    return None


def _slides(points: Array, turns: Sequence[float]) -> list[Array]:
    """Where a cloth's points would lie (along y, along x, 3) after each slide, the better ones first, m."""
    middle = points.reshape(-1, 3).mean(axis=0)
    slides = []
    for nearer, turn in itertools.product(_NEARER, turns):
        for aside in (0.0, -float(middle[1])):
            slides.append((points - middle) @ rotation_z(turn).T + middle + [-nearer, aside, 0.0])
    return slides
