"""Small statistics that batch and summary share."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

# Two-sided 95 % of the normal distribution.
_Z95 = 1.959963984540054


def wilson95(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a success rate: honest for small n and for rates near 0 and 1.

    Returns:
        Lower and upper bound; (0, 1) when nothing was tried.
    """
    if n == 0:
        return 0.0, 1.0
    rate = successes / n
    scale = 1 + _Z95**2 / n
    centre = (rate + _Z95**2 / (2 * n)) / scale
    half = _Z95 / scale * math.sqrt(rate * (1 - rate) / n + _Z95**2 / (4 * n**2))
    # At the ends of the range the bounds are exact; rounding would put them a hair inside.
    return (0.0 if successes == 0 else max(0.0, centre - half), 1.0 if successes == n else min(1.0, centre + half))


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Median, 95th percentile and maximum, or None without values."""
    if not values:
        return None
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95)), "max": float(np.max(values))}
