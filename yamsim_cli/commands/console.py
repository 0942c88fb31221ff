"""What a user sees: results on stdout, everything else on stderr, a progress bar only on a terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console

if TYPE_CHECKING:
    from rich.console import RenderableType

console = Console(stderr=True)

# Without a terminal there is no width to fit: a table in a log must not be cut at 80 columns.
_PIPED_WIDTH = 160

Advance = Callable[[int, int, str], None]


def print_json(data: Mapping[str, Any]) -> None:
    """Write one JSON object to stdout."""
    sys.stdout.write(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def print_table(table: RenderableType) -> None:
    """Write a rich table, or anything rich can draw, to stdout."""
    Console(width=None if sys.stdout.isatty() else _PIPED_WIDTH).print(table)


def print_line(text: str) -> None:
    """Write one line of a result to stdout, as it is."""
    sys.stdout.write(text + "\n")


def note(text: str) -> None:
    """Tell the user something on stderr, as it is."""
    sys.stderr.write(text + "\n")


@contextmanager
def progress_bar(label: str, unit: str) -> Iterator[Advance]:
    """A bar with rate and time left, on a terminal alone; it is called with the number done, the total and a remark."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[remark]}"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=None, rate="", remark="")

        def advance(done: int, total: int, remark: str = "") -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed * 60:.1f} {unit}/min" if speed else ""
            bar.update(task, completed=done, total=total, rate=rate, remark=remark)

        yield advance
