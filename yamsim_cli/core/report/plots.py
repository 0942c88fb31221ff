"""The report's plots as SVG. Their colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from .axes import Axes, Scale, percent
from .markup import Markup, tag

_WIDTH = 460.0
# A limit farther out than this many times the largest distance is only named: to show it would squeeze the histogram.
_STRETCH = 2.0


def distances(
    edges: Sequence[float], counts: Sequence[float], limits: Sequence[float], title: str, counted: str = "episodes"
) -> Markup:
    """A histogram of distances, with a line at every limit; limits far out are only named.

    Args:
        edges: edges of the bins, m.
        counts: counts in the bins.
        limits: distances to mark, m.
        counted: what is counted.
    """
    height, right = 240.0, _WIDTH - 12
    low, high = edges[0] * 1000, edges[-1] * 1000
    near = [limit for limit in limits if limit * 1000 < _STRETCH * high]
    low = 0.0 if limits else low - (edges[1] - edges[0]) * 1000
    high = max([high, *(limit * 1000 for limit in near)]) + (high - low) * 0.04
    # At least 4, so that ticks are whole numbers.
    top = max(max(counts) * 1.08, 4.0)
    axes = Axes(_WIDTH, height, Scale(low, high, 44, right), Scale(0, top, height - 46, 26))
    parts = [
        tag(
            "rect",
            tag("title", f"{a * 1000:g} to {b * 1000:g} mm: {count}"),
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
        parts.append(tag("line", x1=px, x2=px, y1=20, y2=axes.y(0), class_="limit"))
        parts.append(tag("text", f"{limit * 1000:g} mm", x=px + dx, y=30, class_="tick", text_anchor=anchor))
    if far := [f"{limit * 1000:g} mm" for limit in limits if limit not in near]:
        text = f"{', '.join(far)} \N{RIGHTWARDS ARROW}"
        parts.append(tag("text", text, x=right, y=17, class_="tick", text_anchor="end"))
    return axes.svg(title, axes.draw("mm", counted, x_grid=False), *parts)


def bars(counts: Mapping[str, int], bad: bool = True) -> Markup:
    """A horizontal bar for each name, the longest first."""
    row, left = 26.0, 130.0
    height = row * len(counts) + 8
    scale = Scale(0, max(counts.values()), 0, _WIDTH - left - 56)
    parts = []
    for k, (name, count) in enumerate(sorted(counts.items(), key=lambda item: -item[1])):
        y = 4 + k * row
        shown = name if len(name) <= 20 else name[:19] + "\N{HORIZONTAL ELLIPSIS}"
        parts += [
            tag("text", shown, x=left - 8, y=y + 15, class_="name", text_anchor="end"),
            tag("rect", x=left, y=y + 3, width=max(1.0, scale(count)), height=row - 9, class_="bad" if bad else "good"),
            tag("text", f"{count:,}", x=left + scale(count) + 6, y=y + 15, class_="tick"),
        ]
    axes = Axes(_WIDTH, height, scale, scale)
    return axes.svg("Attempts by cause of failure", *parts)


def rates(rows: Sequence[tuple[str, float, tuple[float, float]]]) -> Markup:
    """A line for each rate, with its interval; rows are name, rate, (low, high), all in 0..1."""
    row, left, top = 30.0, 150.0, 6.0
    height = top + row * len(rows) + 26
    low = max(0.0, math.floor(min(interval[0] for _, _, interval in rows) * 10 - 0.5) / 10)
    x = Scale(low, 1.0, left, _WIDTH - 20)
    parts = []
    for value in x.ticks(6):
        px = x(value)
        parts += [
            tag("line", x1=px, x2=px, y1=top, y2=height - 22, class_="grid"),
            tag("text", percent(value, 0), x=px, y=height - 6, class_="tick", text_anchor="middle"),
        ]
    for k, (name, rate, (a, b)) in enumerate(rows):
        y = top + (k + 0.5) * row
        said = f"{percent(rate)} ({percent(a)} to {percent(b)})"
        parts += [
            tag("text", name, x=left - 10, y=y + 4, class_="name", text_anchor="end"),
            tag("line", x1=x(a), x2=x(b), y1=y, y2=y, class_="interval"),
            tag("circle", tag("title", said), cx=x(rate), cy=y, r=4.5, class_="good"),
        ]
    return Axes(_WIDTH, height, x, x).svg("Success rates with 95 % intervals", *parts)
