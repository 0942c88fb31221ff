from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Z95 = 1.959963984540054  # two-sided 95 % quantile of the normal distribution
THRESHOLDS = (0.05, 0.08)  # m, distances from the target that count as success. Source: the lab reports both
_MAX_BINS = 40
_MIN_SPAN = 1e-4  # of values from which the width of bins is computed


def wilson_interval_95(successes: int, n: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a success rate, valid for small n and rates near 0 and 1; (0, 1) for n = 0."""
    if n == 0:
        return 0.0, 1.0
    rate = successes / n
    scale = 1 + Z95**2 / n
    centre = (rate + Z95**2 / (2 * n)) / scale
    half = Z95 / scale * math.sqrt(rate * (1 - rate) / n + Z95**2 / (4 * n**2))
    # For rates of 0 and 1, one bound is exact. Rounding would move that bound slightly inside.
    return (0.0 if successes == 0 else max(0.0, centre - half), 1.0 if successes == n else min(1.0, centre + half))


def student_t_quantile_95(freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t distribution with `freedom` degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))


def summarize_values(values: Sequence[float]) -> dict[str, float] | None:
    """Return median, 95th percentile and maximum; None without values."""
    if not values:
        return None
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95)), "max": float(np.max(values))}


def compute_histogram(values: Sequence[float]) -> dict[str, list[float] | list[int]] | None:
    """Return the bins' `edges`, which are round numbers, and `counts`; None without values."""
    if not values:
        return None
    span = max(max(values) - min(values), _MIN_SPAN)
    power = 10.0 ** math.floor(math.log10(span / _MAX_BINS))
    width = next(power * k for k in (1, 2, 5, 10) if span / (power * k) <= _MAX_BINS)
    low = math.floor(min(values) / width)
    high = max(low + 1, math.ceil(max(values) / width))
    edges = [round(k * width, 12) for k in range(low, high + 1)]
    counts, _ = np.histogram(values, edges)
    return {"edges": edges, "counts": [int(count) for count in counts]}


@dataclass(frozen=True)
class Coverage:
    """Counts of points in a grid of cells (x, y), `hits[ix][iy]`, and of points outside it."""

    shape: tuple[int, int]
    hits: list[list[int]]
    outside: int

    @property
    def hit_cell_count(self) -> int:
        """Number of cells that contain at least one point."""
        return sum(count > 0 for column in self.hits for count in column)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]


def compute_coverage(
    points: Sequence[tuple[float, float]], x: tuple[float, float], y: tuple[float, float], cell: float
) -> Coverage:
    """Return the counts of points (x, y) in cells of at most `cell` that cover ranges `x` and `y`; all in m."""
    shape = (_cell_count(x, cell), _cell_count(y, cell))
    hits = [[0] * shape[1] for _ in range(shape[0])]
    outside = 0
    for px, py in points:
        if x[0] <= px <= x[1] and y[0] <= py <= y[1]:
            hits[_cell_index(px, x, shape[0])][_cell_index(py, y, shape[1])] += 1
        else:
            outside += 1
    return Coverage(shape, hits, outside)


def _cell_count(span: tuple[float, float], cell: float) -> int:
    # The tolerance keeps rounding from dividing 0.25 m into six cells of 0.05 m.
    return max(1, math.ceil((span[1] - span[0]) / cell - 1e-9))


def _cell_index(value: float, span: tuple[float, float], n: int) -> int:
    width = span[1] - span[0]
    return min(n - 1, int((value - span[0]) / width * n)) if width else 0
