"""Curves over time as SVG."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .axes import Axes, Scale
from .markup import Markup, tag

_WIDTH, _HEIGHT = 460.0, 200.0
# Points of a curve: the lowest and the highest of each of half as many stretches, so that no peak is lost.
_MOST_POINTS = 500
# How much room there is above and below, of the span of all curves.
_ROOM = 0.06

Values = NDArray[np.float64]


def curves(
    title: str, times: Values, lines: Mapping[str, Values], y_label: str, mark: float | None = None, least: float = 0.0
) -> Markup:
    """A plot of curves over one time.

    Args:
        times: (n,), s.
        lines: class in the style sheet -> values (n,), NaN where there are none.
        mark: a time to mark, s.
        least: what the plot spans at least, so that noise does not look large.
    """
    known = np.concatenate([values[np.isfinite(values)] for values in lines.values()])
    low, high = float(known.min()), float(known.max())
    if high - low < least:
        low, high = (low + high - least) / 2, (low + high + least) / 2
    room = (high - low) * _ROOM or 1e-9
    axes = Axes(
        _WIDTH,
        _HEIGHT,
        Scale(float(times[0]), float(times[-1]), 52, _WIDTH - 12),
        Scale(low - room, high + room, _HEIGHT - 46, 26),
    )
    parts = [
        tag("polyline", points=_points(axes, times, values), class_=f"curve {kind}") for kind, values in lines.items()
    ]
    if mark is not None:
        x = axes.x(mark)
        parts.append(tag("line", x1=x, x2=x, y1=20, y2=_HEIGHT - 46, class_="limit"))
    return axes.svg(title, axes.draw("s", y_label, x_grid=False, y_ticks=4), *parts)


def _points(axes: Axes, times: Values, values: Values) -> str:
    known = np.isfinite(values)
    at, rows = times[known], values[known]
    if len(at) > _MOST_POINTS:
        parts = np.array_split(np.arange(len(at)), _MOST_POINTS // 2)
        chosen = np.unique([k for part in parts for k in (part[rows[part].argmin()], part[rows[part].argmax()])])
        at, rows = at[chosen], rows[chosen]
    return " ".join(f"{axes.x(x):.1f},{axes.y(y):.1f}" for x, y in zip(at.tolist(), rows.tolist(), strict=True))
