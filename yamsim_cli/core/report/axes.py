"""Axes of a plot: scales from values to pixels, round numbers along the edges, and grid lines."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .markup import Markup, join, tag


@dataclass(frozen=True)
class Scale:
    """A linear scale from values to pixels. `start` is the pixel of `low`, `end` that of `high`; both may decrease."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """The pixel of a value."""
        span = self.high - self.low
        return self.start + (value - self.low) / span * (self.end - self.start) if span else (self.start + self.end) / 2

    def ticks(self, most: int) -> list[float]:
        """Round values between `low` and `high`, about `most` of them."""
        low, high = sorted((self.low, self.high))
        span = high - low
        if span == 0:
            return [low]
        raw = span / max(1, most - 1)
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(power * k for k in (1, 2, 2.5, 5, 10) if power * k >= raw * (1 - 1e-9))
        first = math.ceil(low / step - 1e-9)
        last = math.floor(high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


@dataclass(frozen=True)
class Axes:
    """A rectangle with a scale along its lower edge and one along its left edge."""

    width: float
    height: float
    x: Scale
    y: Scale

    def draw(self, x_label: str, y_label: str, *, x_ticks: int = 6, y_ticks: int = 5, x_grid: bool = True) -> Markup:
        """Grid, numbers and labels."""
        left, right = sorted((self.x.start, self.x.end))
        top, bottom = sorted((self.y.start, self.y.end))
        parts = []
        for value in self.x.ticks(x_ticks):
            px = self.x(value)
            if x_grid:
                parts.append(tag("line", x1=px, x2=px, y1=top, y2=bottom, class_="grid"))
            parts.append(tag("text", number(value), x=px, y=bottom + 16, class_="tick", text_anchor="middle"))
        for value in self.y.ticks(y_ticks):
            py = self.y(value)
            parts.append(tag("line", x1=left, x2=right, y1=py, y2=py, class_="grid"))
            parts.append(tag("text", number(value), x=left - 6, y=py + 3.5, class_="tick", text_anchor="end"))
        parts.append(tag("text", x_label, x=(left + right) / 2, y=bottom + 34, class_="label", text_anchor="middle"))
        parts.append(tag("text", y_label, x=left, y=top - 9, class_="label", text_anchor="start"))
        return join(parts)

    def svg(self, title: str, *parts: Markup) -> Markup:
        """The whole picture, with a title for people who cannot see it."""
        return tag(
            "svg",
            tag("title", title),
            parts,
            viewBox=f"0 0 {self.width:g} {self.height:g}",
            xmlns="http://www.w3.org/2000/svg",
            role="img",
            style=f"max-width:{self.width:g}px",
        )


def number(value: float) -> str:
    """A round number, without the noise of floating point, and with a true minus sign."""
    return f"{round(value, 9) + 0.0:.6g}".replace("-", "\N{MINUS SIGN}")


def percent(rate: float, digits: int = 1) -> str:
    """A rate of 0..1 in per cent."""
    return f"{rate * 100:.{digits}f}\N{NO-BREAK SPACE}%"
