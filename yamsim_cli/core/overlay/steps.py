"""Where the level of a noisy series of vectors steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.se3 import Array

# Fewer samples have no level: one that is off would be half of it.
FEWEST = 4
# A step counts if the squared distance of the levels, in standard deviations, is above this. By chance six independent
# axes are above it once in 20 million (chi-squared with 6 degrees of freedom): no false step in a series of thousands.
_SURE = 45.0
# A sample counts for no more than so many standard deviations: one wrong pose is no step.
_CLIP = 6.0
# From a median absolute deviation to a standard deviation, of normal noise.
_FROM_MEDIAN = 1.4826
# A median of n samples spreads so much more than their mean, squared.
_MEDIAN_SPREAD = np.pi / 2


@dataclass(frozen=True)
class Step:
    """A step of a series.

    Attributes:
        at: the first sample after it.
        before, after: the levels (d,) on both sides, up to the steps before and after this one.
        sigma: standard deviation (d,) of the difference between the levels.
        strength: the squared difference in standard deviations, all axes together.
    """

    at: int
    before: Array
    after: Array
    sigma: Array
    strength: float


def noise_of(series: Array, least: Array) -> Array:
    """Standard deviations (d,) of a series (n, d) from one sample to the next, which a few steps do not change.

    Args:
        least: what they are at least (d,).
    """
    jumps = np.abs(np.diff(series, axis=0))
    sigma: Array = np.maximum(_FROM_MEDIAN * np.median(jumps, axis=0) / np.sqrt(2), least)
    return sigma


def find_steps(series: Array, least: Array) -> list[Step]:
    """The steps of a series (n, d), in order.

    Between two steps the series stays at a level, the median of at least four samples, so that single samples that are
    off make none.

    Args:
        least: standard deviations (d,) that the noise has at least.
    """
    if len(series) < 2 * FEWEST:
        return []
    sigma = noise_of(series, least)
    places = sorted(_split(series / sigma, 0))
    edges = [0, *places, len(series)]
    steps = [step_at(series[a:c], b - a, sigma) for a, b, c in zip(edges, edges[1:], edges[2:], strict=False)]
    return [
        Step(start + step.at, step.before, step.after, step.sigma, step.strength)
        for start, step in zip(edges, steps, strict=False)
        if step.strength > _SURE
    ]


def step_at(series: Array, at: int, sigma: Array) -> Step:
    """What a step before sample `at` of a series would be, whose noise has standard deviations `sigma` (d,)."""
    before, after = np.median(series[:at], axis=0), np.median(series[at:], axis=0)
    spread = sigma * np.sqrt(_MEDIAN_SPREAD * (1 / at + 1 / (len(series) - at)))
    return Step(at, before, after, spread, float(np.sum(((after - before) / spread) ** 2)))


def _split(series: Array, start: int) -> list[int]:
    """Where a whitened series steps, by halving it where that explains it best."""
    n = len(series)
    if n < 2 * FEWEST:
        return []
    costs = [_cost(series[:k]) + _cost(series[k:]) for k in range(FEWEST, n - FEWEST + 1)]
    at = FEWEST + int(np.argmin(costs))
    if step_at(series, at, np.ones(series.shape[1])).strength <= _SURE:
        return []
    return [*_split(series[:at], start), start + at, *_split(series[at:], start + at)]


def _cost(series: Array) -> float:
    """How far samples lie from their level, in standard deviations, each one counted up to a limit."""
    return float(np.minimum(np.abs(series - np.median(series, axis=0)), _CLIP).sum())
