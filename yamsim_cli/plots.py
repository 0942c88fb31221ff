"""Plots as SVG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .core.markup import Markup, html_tag, join_markup, percent
from .core.statistics import Coverage

_WIDTH = 460.0  # px, except the workspace plot
_PLAN_WIDTH, _PLAN_MAX_HEIGHT = 300.0, 330.0  # px, of the workspace plot

_MAX_SHOWN_LIMIT_RATIO = 2.0  # of the largest distance; a line at a limit beyond it would squeeze the bars
_MAX_CURVE_POINTS = 500  # minimum and maximum of each of 250 intervals, which keeps every peak
_CURVE_PADDING = 0.06  # above and below curves, as a share of their span
_MAX_DOTS = 4000  # of one series in a workspace plot; more cannot be distinguished, and make the page large
_MAX_NAME = 20  # characters of a bar's label; longer labels are cut

Values = NDArray[np.float64]
Point = tuple[float, float]


@dataclass(frozen=True)
class PixelScale:
    """A linear scale from values to pixels: from `low` at pixel `start` to `high` at pixel `end`."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """Return the pixel of a value."""
        span = self.high - self.low
        return self.start + (value - self.low) / span * (self.end - self.start) if span else (self.start + self.end) / 2

    def round_tick_values(self, maximum: int) -> list[float]:
        """Return at most `maximum` round values between `low` and `high`."""
        low, high = sorted((self.low, self.high))
        span = high - low
        if span == 0:
            return [low]
        raw = span / max(1, maximum - 1)
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(power * k for k in (1, 2, 2.5, 5, 10) if power * k >= raw * (1 - 1e-9))
        first = math.ceil(low / step - 1e-9)
        last = math.floor(high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


@dataclass(frozen=True)
class Axes:
    """The scales of a plot: `x` along its lower edge, `y` along its left edge."""

    x: PixelScale
    y: PixelScale

    def draw(self, x_label: str, y_label: str, *, x_ticks: int = 6, y_ticks: int = 5, x_grid: bool = True) -> Markup:
        """Return grid lines, their numbers, and the labels of both axes."""
        left, right = sorted((self.x.start, self.x.end))
        top, bottom = sorted((self.y.start, self.y.end))
        parts = []
        for value in self.x.round_tick_values(x_ticks):
            px = self.x(value)
            if x_grid:
                parts.append(html_tag("line", x1=px, x2=px, y1=top, y2=bottom, class_="grid"))
            parts.append(
                html_tag("text", format_number(value), x=px, y=bottom + 16, class_="tick", text_anchor="middle")
            )
        for value in self.y.round_tick_values(y_ticks):
            py = self.y(value)
            parts.append(html_tag("line", x1=left, x2=right, y1=py, y2=py, class_="grid"))
            parts.append(
                html_tag("text", format_number(value), x=left - 6, y=py + 3.5, class_="tick", text_anchor="end")
            )
        parts.append(
            html_tag("text", x_label, x=(left + right) / 2, y=bottom + 34, class_="label", text_anchor="middle")
        )
        parts.append(html_tag("text", y_label, x=left, y=top - 9, class_="label", text_anchor="start"))
        return join_markup(parts)


def format_number(value: float) -> str:
    """Return a number as text, without rounding errors, with a typographic minus sign."""
    return f"{round(value, 9) + 0.0:.6g}".replace("-", "\N{MINUS SIGN}")


def plot_distance_histogram(
    edges: Sequence[float], counts: Sequence[float], limits: Sequence[float], title: str, counted: str = "episodes"
) -> Markup:
    """Return a histogram of distances (m), with a line at every limit; limits far beyond the data are written as text.

    `counted` labels the vertical axis.
    """
    height, right = 240.0, _WIDTH - 12
    low, high = edges[0] * 1000, edges[-1] * 1000
    near = [limit for limit in limits if limit * 1000 < _MAX_SHOWN_LIMIT_RATIO * high]
    low = 0.0 if limits else low - (edges[1] - edges[0]) * 1000
    high = max([high, *(limit * 1000 for limit in near)]) + (high - low) * 0.04
    # If the axis of counts reaches at least 4, its ticks are whole numbers.
    top = max(max(counts) * 1.08, 4.0)
    axes = Axes(PixelScale(low, high, 44, right), PixelScale(0, top, height - 46, 26))
    parts = [
        html_tag(
            "rect",
            html_tag("title", f"{a * 1000:g} to {b * 1000:g} mm: {count}"),
            x=axes.x(a * 1000) + 0.5,
            y=axes.y(count),
            width=max(0.5, axes.x(b * 1000) - axes.x(a * 1000) - 1),
            height=axes.y(0) - axes.y(count),
            class_="good",
        )
        for a, b, count in zip(edges[:-1], edges[1:], counts, strict=True)
        if count
    ]
    for limit in near:
        px = axes.x(limit * 1000)
        anchor, dx = ("end", -4) if px > right - 60 else ("start", 4)
        parts.append(html_tag("line", x1=px, x2=px, y1=20, y2=axes.y(0), class_="limit"))
        parts.append(html_tag("text", f"{limit * 1000:g} mm", x=px + dx, y=30, class_="tick", text_anchor=anchor))
    if far := [f"{limit * 1000:g} mm" for limit in limits if limit not in near]:
        text = f"{', '.join(far)} \N{RIGHTWARDS ARROW}"
        parts.append(html_tag("text", text, x=right, y=17, class_="tick", text_anchor="end"))
    return _svg_figure(title, _WIDTH, height, axes.draw("mm", counted, x_grid=False), parts)


def plot_failures(counts: Mapping[str, int]) -> Markup:
    """Return a plot with a bar for each cause of failure, the longest first."""
    row, left = 26.0, 130.0
    scale = PixelScale(0, max(counts.values()), 0, _WIDTH - left - 56)
    parts = []
    for k, (name, count) in enumerate(sorted(counts.items(), key=lambda item: -item[1])):
        y = 4 + k * row
        shown = name if len(name) <= _MAX_NAME else name[: _MAX_NAME - 1] + "\N{HORIZONTAL ELLIPSIS}"
        parts += [
            html_tag("text", shown, x=left - 8, y=y + 15, class_="name", text_anchor="end"),
            html_tag("rect", x=left, y=y + 3, width=max(1.0, scale(count)), height=row - 9, class_="bad"),
            html_tag("text", f"{count:,}", x=left + scale(count) + 6, y=y + 15, class_="tick"),
        ]
    return _svg_figure("Attempts by cause of failure", _WIDTH, row * len(counts) + 8, parts)


def plot_rates(rows: Sequence[tuple[str, float, tuple[float, float]]]) -> Markup:
    """Return a plot of rates with their intervals; rows are name, rate, (low, high), with values in 0..1."""
    row, left, top = 30.0, 150.0, 6.0
    height = top + row * len(rows) + 26
    low = max(0.0, math.floor(min(interval[0] for _, _, interval in rows) * 10 - 0.5) / 10)
    x = PixelScale(low, 1.0, left, _WIDTH - 20)
    parts = []
    for value in x.round_tick_values(6):
        px = x(value)
        parts += [
            html_tag("line", x1=px, x2=px, y1=top, y2=height - 22, class_="grid"),
            html_tag("text", percent(value, 0), x=px, y=height - 6, class_="tick", text_anchor="middle"),
        ]
    for k, (name, rate, (a, b)) in enumerate(rows):
        y = top + (k + 0.5) * row
        parts += [
            html_tag("text", name, x=left - 10, y=y + 4, class_="name", text_anchor="end"),
            html_tag("line", x1=x(a), x2=x(b), y1=y, y2=y, class_="interval"),
            html_tag(
                "circle",
                html_tag("title", f"{percent(rate)} ({percent(a)} to {percent(b)})"),
                cx=x(rate),
                cy=y,
                r=4.5,
                class_="good",
            ),
        ]
    return _svg_figure("Success rates with 95 % intervals", _WIDTH, height, parts)


def plot_curves(
    title: str,
    times: Values,
    lines: Mapping[str, Values],
    y_label: str,
    mark: float | None = None,
    min_span: float = 0.0,
) -> Markup:
    """Return a plot of curves over time.

    Args:
        times: (n,), s.
        lines: class in the style sheet -> values (n,) of a curve, NaN where unknown.
        mark: time of a vertical line, s.
        min_span: of the vertical axis, so that noise does not look large.
    """
    height = 200.0
    known = np.concatenate([values[np.isfinite(values)] for values in lines.values()])
    low, high = float(known.min()), float(known.max())
    if high - low < min_span:
        low, high = (low + high - min_span) / 2, (low + high + min_span) / 2
    room = (high - low) * _CURVE_PADDING or 1e-9
    axes = Axes(
        PixelScale(float(times[0]), float(times[-1]), 52, _WIDTH - 12),
        PixelScale(low - room, high + room, height - 46, 26),
    )
    parts = [
        html_tag("polyline", points=_polyline_points(axes, times, values), class_=f"curve {kind}")
        for kind, values in lines.items()
    ]
    if mark is not None:
        x = axes.x(mark)
        parts.append(html_tag("line", x1=x, x2=x, y1=20, y2=height - 46, class_="limit"))
    return _svg_figure(title, _WIDTH, height, axes.draw("s", y_label, x_grid=False, y_ticks=4), parts)


def _polyline_points(axes: Axes, times: Values, values: Values) -> str:
    known = np.isfinite(values)
    x, y = times[known], values[known]
    if len(x) > _MAX_CURVE_POINTS:
        stretches = np.array_split(np.arange(len(x)), _MAX_CURVE_POINTS // 2)
        kept = np.unique([k for part in stretches for k in (part[y[part].argmin()], part[y[part].argmax()])])
        x, y = x[kept], y[kept]
    return " ".join(f"{axes.x(a):.1f},{axes.y(b):.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


@dataclass(frozen=True)
class ObjectPlaces:
    """Positions (x, y) of one object at the start or at the end of attempts, m.

    Attributes:
        good: in successful episodes.
        bad: in episodes without success.
        failed: in failed attempts.
        grid: counts of the positions in cells of the box from which starts are sampled.
    """

    good: Sequence[Point]
    bad: Sequence[Point] = ()
    failed: Sequence[Point] = ()
    grid: Coverage | None = None


def plot_workspace(places: ObjectPlaces, box: tuple[Point, Point] | None, frame: str, title: str) -> Markup:
    """Return a plot of the workspace from above, the robot's base at the bottom: x points up, y to the left, in m.

    Starts are sampled from `box`, ranges of x and y. `frame` is the name of the points' frame.
    """
    points = [*places.good, *places.bad, *places.failed]
    corners = [*points, *zip(*box, strict=True)] if box else points
    (x_low, x_high), (y_low, y_high) = (_padded_range([corner[k] for corner in corners]) for k in (0, 1))
    left, right, top = 46.0, _PLAN_WIDTH - 10, 26.0
    # Both axes have the same scale. A plot that would be too tall becomes narrower.
    scale = min((right - left) / (y_high - y_low), _PLAN_MAX_HEIGHT / (x_high - x_low))
    right, bottom = left + scale * (y_high - y_low), top + scale * (x_high - x_low)
    axes = Axes(PixelScale(y_high, y_low, left, right), PixelScale(x_low, x_high, bottom, top))
    return _svg_figure(
        title,
        _PLAN_WIDTH,
        bottom + 42,
        _coverage_cells(axes, box, places.grid) if box and places.grid else None,
        axes.draw(f"y, m, in {frame}", "x, m", x_ticks=5),
        _svg_rectangle(axes, *box, "box") if box else None,
        # Strokes without length are dots. They take a tenth of the bytes of circles.
        _marker_path(axes, places.good, 0.0, "h0", "dots good-dots"),
        _marker_path(axes, places.bad, 0.0, "h0", "dots bad-dots"),
        _marker_path(axes, places.failed, 2.5, "l5 5m0 -5l-5 5", "crosses"),
    )


def _coverage_cells(axes: Axes, box: tuple[Point, Point], grid: Coverage) -> list[Markup]:
    (x0, x1), (y0, y1) = box
    dx, dy = (x1 - x0) / grid.shape[0], (y1 - y0) / grid.shape[1]
    return [
        _svg_rectangle(axes, (x0 + ix * dx, x0 + (ix + 1) * dx), (y0 + iy * dy, y0 + (iy + 1) * dy), "cell")
        for ix, column in enumerate(grid.hits)
        for iy, count in enumerate(column)
        if count
    ]


def _svg_rectangle(axes: Axes, x: Point, y: Point, kind: str) -> Markup:
    left, top = axes.x(y[1]), axes.y(x[1])
    return html_tag("rect", x=left, y=top, width=axes.x(y[0]) - left, height=axes.y(x[0]) - top, class_=kind)


def _marker_path(axes: Axes, points: Sequence[Point], offset: float, stroke: str, kind: str) -> Markup | None:
    """Return one path with a stroke at every point, from `offset` px above and left of it."""
    if not points:
        return None
    kept = points[:: math.ceil(len(points) / _MAX_DOTS)]
    path = "".join(f"M{axes.x(y) - offset:.1f} {axes.y(x) - offset:.1f}{stroke}" for x, y in kept)
    return html_tag("path", d=path, class_=kind)


def _padded_range(values: Sequence[float]) -> Point:
    low, high = min(values), max(values)
    pad = max(0.02, (high - low) * 0.06)
    return low - pad, high + pad


def _svg_figure(title: str, width: float, height: float, *parts: Markup | Sequence[Markup] | None) -> Markup:
    return html_tag(
        "svg",
        html_tag("title", title),
        parts,
        viewBox=f"0 0 {width:g} {height:g}",
        xmlns="http://www.w3.org/2000/svg",
        role="img",
        style=f"max-width:{width:g}px",
    )
