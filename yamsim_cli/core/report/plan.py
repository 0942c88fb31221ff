"""A plot of the workspace from above: where objects lay, and which cells of the sampling box were hit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..dataset.statistics import Coverage
from .axes import Axes, Scale
from .markup import Markup, tag

Point = tuple[float, float]

_WIDTH = 300.0
_MOST_HEIGHT = 330.0
# Most dots in a plot: more of them cannot be told apart, and make the page large.
_MOST_DOTS = 4000


@dataclass(frozen=True)
class Places:
    """Where an object lay.

    Attributes:
        good: its places in episodes that count as a success.
        bad: its places in episodes that do not.
        failed: its places in attempts that failed.
        grid: how its places cover the sampling box; None where the box is not known.
    """

    good: Sequence[Point]
    bad: Sequence[Point] = ()
    failed: Sequence[Point] = ()
    grid: Coverage | None = None


def workspace(places: Places, box: tuple[Point, Point] | None, frame: str, title: str) -> Markup:
    """The plot, with the robot's base at the bottom: x points up and y to the left, both in metres.

    Args:
        box: the sampling box, as x and y ranges.
        frame: name of the frame that the points are in.
    """
    points = [*places.good, *places.bad, *places.failed]
    corners = [*points, *zip(*box, strict=True)] if box else points
    (x_low, x_high), (y_low, y_high) = (_padded([corner[k] for corner in corners]) for k in (0, 1))
    left, right, top = 46.0, _WIDTH - 10, 26.0
    # A metre is as long on both axes. A plot that would get too tall is made narrower.
    scale = min((right - left) / (y_high - y_low), _MOST_HEIGHT / (x_high - x_low))
    right, bottom = left + scale * (y_high - y_low), top + scale * (x_high - x_low)
    axes = Axes(_WIDTH, bottom + 42, Scale(y_high, y_low, left, right), Scale(x_low, x_high, bottom, top))
    return axes.svg(
        title,
        *(_cells(axes, box, places.grid) if box else []),
        axes.draw(f"y, m, in {frame}", "x, m", x_ticks=5),
        *([_outline(axes, box)] if box else []),
        _dots(axes, places.good, "good"),
        _dots(axes, places.bad, "bad"),
        _crosses(axes, places.failed),
    )


def _cells(axes: Axes, box: tuple[Point, Point], grid: Coverage | None) -> list[Markup]:
    """The cells that were hit."""
    if grid is None:
        return []
    (x0, x1), (y0, y1) = box
    dx, dy = (x1 - x0) / grid.shape[0], (y1 - y0) / grid.shape[1]
    return [
        _rectangle(axes, (x0 + ix * dx, x0 + (ix + 1) * dx), (y0 + iy * dy, y0 + (iy + 1) * dy), "cell")
        for ix, column in enumerate(grid.hits)
        for iy, count in enumerate(column)
        if count
    ]


def _outline(axes: Axes, box: tuple[Point, Point]) -> Markup:
    return _rectangle(axes, *box, "box")


def _rectangle(axes: Axes, x: Point, y: Point, kind: str) -> Markup:
    """A rectangle over ranges of the workspace's x and y, m."""
    left, top = axes.x(y[1]), axes.y(x[1])
    return tag("rect", x=left, y=top, width=axes.x(y[0]) - left, height=axes.y(x[0]) - top, class_=kind)


def _dots(axes: Axes, points: Sequence[Point], kind: str) -> Markup:
    """Dots as one path of strokes without length, which takes a tenth of the bytes of as many circles."""
    if not points:
        return Markup("")
    path = "".join(f"M{axes.x(y):.1f} {axes.y(x):.1f}h0" for x, y in _thinned(points))
    return tag("path", d=path, class_=f"dots {kind}-dots")


def _crosses(axes: Axes, points: Sequence[Point]) -> Markup:
    if not points:
        return Markup("")
    path = "".join(f"M{axes.x(y) - 2.5:.1f} {axes.y(x) - 2.5:.1f}l5 5m0 -5l-5 5" for x, y in _thinned(points))
    return tag("path", d=path, class_="crosses")


def _thinned(points: Sequence[Point]) -> Sequence[Point]:
    step = math.ceil(len(points) / _MOST_DOTS)
    return points[::step]


def _padded(values: Sequence[float]) -> Point:
    low, high = min(values), max(values)
    pad = max(0.02, (high - low) * 0.06)
    return low - pad, high + pad
