"""Learning curves as a picture: the loss over steps, and success over demonstrations with its 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

_WIDTH, _HEIGHT, _LEFT, _TOP, _GAP = 860, 330, 55, 34, 70
_PANEL = (_WIDTH - 2 * _LEFT - _GAP) / 2
_BOTTOM = _HEIGHT - 48
_COLOURS = {"weld": "#0a6", "contact": "#c40", "randomized": "#36c"}
_LEAST_LOSS, _MOST_LOSS = 0.01, 1.0

Scale = Callable[[float], float]


def plot_training(runs: Sequence[dict[str, Any]], log_every: int, path: Path) -> None:
    """Write the picture of some runs of `tests.bench.training` as SVG."""
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
    for run in runs:
        points = " ".join(f"{x((k + 1) * log_every):.1f},{y(loss):.1f}" for k, loss in enumerate(run["loss"]))
        faint = 0.25 + 0.75 * math.log2(run["episodes"] / 12.5) / 4
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{_COLOURS[run["kind"]]}" stroke-opacity="{faint:.2f}"/>'
        )
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
    kinds = list(dict.fromkeys(run["kind"] for run in runs))
    for number, kind in enumerate(kinds):
        colour, of_kind = _COLOURS[kind], [run for run in runs if run["kind"] == kind]
        # Beside each other, so that no interval hides another.
        aside = 7 * number
        points = [(x(run["episodes"]) + aside, run) for run in sorted(of_kind, key=lambda run: int(run["episodes"]))]
        line = " ".join(f"{at:.1f},{y(run['n_success'] / run['n']):.1f}" for at, run in points)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}"/>')
        for at, run in points:
            ends = [y(end) for end in run["wilson95"]]
            parts.append(f'<path d="M{at:.1f} {ends[0]:.1f}V{ends[1]:.1f}" stroke="{colour}" stroke-width="2"/>')
            centre = y(run["n_success"] / run["n"])
            parts.append(f'<circle cx="{at:.1f}" cy="{centre:.1f}" r="4" fill="{colour}"/>')
        parts.append(_text(left + _PANEL - 8, _BOTTOM - 12 - 16 * (len(kinds) - 1 - number), kind, "end", colour))
    return parts


def _frame(title: str, below: str, left: float) -> list[str]:
    return [_text(left, _TOP - 14, title, "start"), _text(left + _PANEL / 2, _HEIGHT - 12, below)]


def _rule(left: float, y: float, label: str) -> str:
    line = f'<path d="M{left:.1f} {y:.1f}h{_PANEL:.1f}" stroke="#ddd"/>'
    return line + _text(left - 6, y + 4, label, "end")


def _text(x: float, y: float, text: str, anchor: str = "middle", colour: str = "black") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{text}</text>'
