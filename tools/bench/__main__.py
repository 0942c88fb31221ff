"""`make bench`: cost of recording on this machine, against a plain pipeline and against the lower bound.

    python -m tools.bench [--episodes N] [--plain-episodes N] [--json FILE]

A slow machine fails nothing. Leave the machine alone meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from tools.bench.setting import use_gl

if TYPE_CHECKING:
    from tools.bench.pipeline import PipelineFigures

# Width of the widest table, characters.
_WIDTH = 122


def main() -> None:
    """Measure, print, and write the figures with --json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=12, help="of ours, for each quality and number of workers")
    parser.add_argument("--plain-episodes", type=int, default=3, help="of the plain pipeline")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    renderer = use_gl()
    # As in `yamsim record`: one rendering thread per worker, and one worker per core.
    os.environ.setdefault("LP_NUM_THREADS", "0")

    from tools.bench.parts import measure_parts
    from tools.bench.pipeline import alone, measure_pipeline

    console = Console(width=max(_WIDTH, Console().width))
    console.print(f"{os.cpu_count()} cores, {renderer}\n")
    parts = alone(measure_parts, 10)
    console.print(_parts_table(parts))
    figures = measure_pipeline(arguments.plain_episodes, arguments.episodes)
    console.print(_rates_table(figures))
    console.print(_floor_table(figures))
    if arguments.json:
        document = {"renderer": renderer, "cores": os.cpu_count(), "parts_s": parts, "pipeline": asdict(figures)}
        arguments.json.write_text(json.dumps(document, indent=2) + "\n")


def _parts_table(parts: dict[str, float]) -> Table:
    table = Table(title="Each part alone, in one process", title_justify="left")
    table.add_column("part")
    table.add_column("ms", justify="right")
    for name, seconds in parts.items():
        table.add_row(name, f"{seconds * 1000:.2f}")
    return table


def _rates_table(figures: PipelineFigures) -> Table:
    table = Table(title="The main job, episodes a minute", title_justify="left")
    columns = ("1 worker", "2 workers", "4 workers", "2 to 1", "b/a, one core", "b/a, machine", "SSIM to a", "to high")
    for column in ("pipeline", *columns):
        table.add_column(column, justify="left" if column == "pipeline" else "right", no_wrap=True)
    table.add_row("(a) plain, one core", f"{60 / figures.plain_one_thread_s:.1f}")
    table.add_row("(a) plain, machine", f"{60 / figures.plain_s:.1f}")
    for name, ours in figures.qualities.items():
        seconds = ours.seconds_per_episode
        table.add_row(
            f"(b) {name}",
            *(f"{60 / each:.1f}" for each in seconds.values()),
            f"{seconds[1] / seconds[2]:.2f}",
            f"{figures.plain_one_thread_s / seconds[1]:.1f}",
            f"{figures.plain_s / min(seconds.values()):.1f}",
            f"{ours.ssim_plain:.3f}",
            f"{ours.ssim_high:.3f}",
        )
    return table


def _floor_table(figures: PipelineFigures) -> Table:
    table = Table(title="One worker's time, s an episode", title_justify="left")
    parts = next(iter(figures.qualities.values())).floor_s
    for column in ("quality", "ours", *parts, "(c) together", "outside", "until the first"):
        table.add_column(column, justify="left" if column == "quality" else "right", no_wrap=True)
    for name, ours in figures.qualities.items():
        table.add_row(
            name,
            f"{ours.seconds_per_episode[1]:.2f}",
            *(f"{seconds:.3f}" for seconds in ours.floor_s.values()),
            f"{sum(ours.floor_s.values()):.2f}",
            f"{ours.outside_floor:.0%}",
            f"{ours.start_s:.1f}",
        )
    return table


if __name__ == "__main__":
    main()
