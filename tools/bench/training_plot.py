"""Learning curves: the loss over steps, and success over demonstrations with 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

_WIDTH, _HEIGHT, _LEFT, _TOP, _GAP = 860, 330, 55, 34, 70
_PANEL = (_WIDTH - 2 * _LEFT - _GAP) / 2
_BOTTOM = _HEIGHT - 48
_COLOURS = ("#063", "#0a6", "#c40", "#36c", "#808", "#a80")
_LEAST_LOSS, _MOST_LOSS = 0.01, 1.0

Scale = Callable[[float], float]


def plot_training(runs: Sequence[dict[str, Any]], log_every: int, path: Path) -> None:
    """Plot runs of `tools.bench.training` as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        'font-size="12">',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        *_losses(runs, log_every),
        *_successes(runs),
        "</svg>",
    ]
    path.write_text("\n".join(parts) + "\n")


def _losses(runs: Sequence[dict[str, Any]], log_every: int) -> list[str]:
    steps = max(len(run["loss"]) for run in runs) * log_every
    decades = math.log10(_MOST_LOSS / _LEAST_LOSS)

    def x(step: float) -> float:
        return _LEFT + step / steps * _PANEL

    def y(loss: float) -> float:
        return _TOP + math.log10(_MOST_LOSS / max(loss, _LEAST_LOSS)) / decades * (_BOTTOM - _TOP)

    parts = _frame("Loss of training (L1 of normalized actions)", "step", _LEFT)
    parts += [_rule(_LEFT, y(loss), f"{loss:g}") for loss in (0.01, 0.03, 0.1, 0.3, 1.0)]
    parts += [
        _text(x(step), _BOTTOM + 16, f"{step:g}") for step in range(0, steps + 1, max(1000, steps // 6000 * 1000))
    ]
    colours = _series(runs)
    most = max(run["episodes"] for run in runs)
    for run in runs:
        points = " ".join(f"{x((k + 1) * log_every):.1f},{y(loss):.1f}" for k, loss in enumerate(run["loss"]))
        # The fewer demonstrations, the fainter.
        drawn = f'stroke="{colours[_name(run)]}" stroke-opacity="{(run["episodes"] / most) ** 0.5:.2f}"'
        parts.append(f'<polyline points="{points}" fill="none" {drawn}/>')
    return parts


def _successes(runs: Sequence[dict[str, Any]]) -> list[str]:
    left = _LEFT + _PANEL + _GAP
    counts = sorted({run["episodes"] for run in runs})
    low, high = math.log2(counts[0] / 1.3), math.log2(counts[-1] * 1.3)

    def x(episodes: float) -> float:
        return left + (math.log2(episodes) - low) / (high - low) * _PANEL

    def y(share: float) -> float:
        return _TOP + (1 - share) * (_BOTTOM - _TOP)

    parts = _frame("Success of held-out trials, 95 % interval", "demonstrations", left)
    parts += [_rule(left, y(share), f"{share:.0%}") for share in (0, 0.25, 0.5, 0.75, 1)]
    parts += [_text(x(count), _BOTTOM + 16, str(count)) for count in counts]
    colours = _series(runs)
    for number, (name, colour) in enumerate(colours.items()):
        alike = sorted((run for run in runs if _name(run) == name), key=lambda run: int(run["episodes"]))
        # Beside each other, so that no interval hides another.
        places = [x(run["episodes"]) + 7 * number for run in alike]
        rates = [y(run["n_success"] / run["n"]) for run in alike]
        line = " ".join(f"{at:.1f},{rate:.1f}" for at, rate in zip(places, rates, strict=True))
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}"/>')
        for at, rate, run in zip(places, rates, alike, strict=True):
            low_end, high_end = (y(end) for end in run["wilson95"])
            parts.append(f'<path d="M{at:.1f} {low_end:.1f}V{high_end:.1f}" stroke="{colour}" stroke-width="2"/>')
            parts.append(f'<circle cx="{at:.1f}" cy="{rate:.1f}" r="4" fill="{colour}"/>')
        # At the lower right, where there are no curves.
        parts.append(_text(left + _PANEL - 8, _BOTTOM - 70 + 16 * number, name, "end", colour))
    return parts


def _series(runs: Sequence[dict[str, Any]]) -> dict[str, str]:
    """The curves with their colours."""
    return dict(zip(dict.fromkeys(_name(run) for run in runs), _COLOURS, strict=False))


def _name(run: dict[str, Any]) -> str:
    """Common name of the runs of one curve."""
    return f"{run['kind']}, {run['steps']} steps"


def _frame(title: str, below: str, left: float) -> list[str]:
    return [_text(left, _TOP - 14, title, "start"), _text(left + _PANEL / 2, _HEIGHT - 12, below)]


def _rule(left: float, y: float, label: str) -> str:
    line = f'<path d="M{left:.1f} {y:.1f}h{_PANEL:.1f}" stroke="#ddd"/>'
    return line + _text(left - 6, y + 4, label, "end")


def _text(x: float, y: float, text: str, anchor: str = "middle", colour: str = "black") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{text}</text>'
