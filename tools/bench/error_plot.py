"""Plot errors over distance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np


def plot_errors(errors: Mapping[float, Sequence[float]], path: Path) -> None:
    """Plot median and 95 % of errors (mm) over distances (m) on logarithmic axes, as SVG."""
    width, height, left, top = 560, 360, 70, 30
    low, high = -3.0, 2.0

    def x(distance: float) -> float:
        return left + (distance - 0.2) / 1.4 * (width - left - 20)

    def y(error: float) -> float:
        return top + (high - math.log10(max(error, 10**low))) / (high - low) * (height - top - 50)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="{left}" y="18">Error of the board centre over range, mm: median (line) and 95 % (dashes)</text>',
    ]
    for power in range(int(low), int(high) + 1):
        parts.append(f'<path d="M{left} {y(10.0**power)}H{width - 20}" stroke="#ddd"/>')
        parts.append(f'<text x="{left - 8}" y="{y(10.0**power) + 4}" text-anchor="end">{10.0**power:g}</text>')
    points: dict[str, list[str]] = {"": [], "6 4": []}
    for distance, values in errors.items():
        parts.append(f'<text x="{x(distance)}" y="{height - 30}" text-anchor="middle">{distance}</text>')
        for dashes, share in (("", 0.5), ("6 4", 0.95)) if len(values) else ():
            points[dashes].append(f"{x(distance):.1f} {y(float(np.quantile(values, share))):.1f}")
    for dashes, line in points.items():
        parts.append(
            f'<path d="M{"L".join(line)}" fill="none" stroke="#0a6" stroke-dasharray="{dashes}" stroke-width="2"/>'
        )
    parts.append(f'<text x="{(left + width) / 2}" y="{height - 8}" text-anchor="middle">range, m</text></svg>')
    path.write_text("\n".join(parts))
