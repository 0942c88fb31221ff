"""Print results to stdout and everything else to stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rich.console import Console

if TYPE_CHECKING:
    from rich.console import RenderableType

console = Console(stderr=True)

_LOG_PERIOD_SECONDS = 30.0  # s between progress lines without a terminal; a shorter job writes none

_end_notes = list[str]()  # for stderr at the end of the command


class ProgressCallback(Protocol):
    """Reports a job's progress."""

    def __call__(self, done: int, total: int, remark: str = "", /) -> None:
        """Show that `done` of `total` items are done, with a remark."""


def print_json(data: Mapping[str, Any]) -> None:
    """Write a mapping to stdout as a JSON object."""
    from yamsim_cli.core.files.documents.json_text import json_text

    sys.stdout.write(json_text(data))


def print_report(report: Mapping[str, Any], table: Callable[[], RenderableType], json: bool) -> None:
    """Write a result to stdout: `report` as JSON, or the table that `table()` returns."""
    if json:
        print_json(report)
    else:
        print_table(table())


def print_result_now(data: Mapping[str, Any], line: str, json: bool) -> None:
    """Write a result to stdout before the command ends: `data` as JSON, or `line`."""
    if json:
        print_json(data)
    else:
        print_line(line)
    # A program that reads from a pipe needs the result before the command ends.
    sys.stdout.flush()


def print_table(table: RenderableType) -> None:
    """Write a rich renderable to stdout, as wide as the terminal, or 80 columns without one."""
    out = Console()
    if out.is_terminal:
        out.print(table)
        return
    with out.capture() as captured:
        out.print(table)
    # Rich pads every line to the table's width.
    sys.stdout.writelines(f"{line.rstrip()}\n" for line in captured.get().splitlines())


def print_line(text: str) -> None:
    """Write one line of a result to stdout."""
    sys.stdout.write(text + "\n")


def print_wrapped_text(marked: str, text: str, style: str) -> None:
    """Write to stdout `marked` in the rich style `style`, and to its right `text`, wrapped."""
    from rich.table import Table
    from rich.text import Text

    row = Table.grid(padding=(0, 2, 0, 0))
    row.add_column(style=style, no_wrap=True)
    row.add_column(overflow="fold")
    row.add_row(Text(marked), Text(text))
    print_table(row)


def print_note(text: str) -> None:
    """Write a line for the user to stderr."""
    sys.stderr.write(text + "\n")


def note_moved(path: Path, moved: Path | None) -> None:
    """Note that an older output at `path` was renamed to `moved`, unless `moved` is None."""
    if moved:
        print_note(f"Moved the existing {path} to {moved}.")


def note_at_end(text: str) -> None:
    """Queue a line for stderr at the end of the command. Duplicates are ignored."""
    if text not in _end_notes:
        _end_notes.append(text)


def write_end_notes() -> None:
    """Write and empty the queue of `note_at_end`."""
    for text in _end_notes:
        print_note(text)
    _end_notes.clear()


@contextmanager
def progress_bar(label: str, unit: str, log_seconds: float | None = None) -> Iterator[ProgressCallback]:
    """Yield a function that shows progress, rate and time left on stderr: a bar in a terminal, else lines of text.

    Args:
        unit: of the counted items, in the plural.
        log_seconds: s before and between lines of text; None for 30 s.
    """
    if console.is_terminal:
        with _terminal_progress_bar(label, unit) as advance:
            yield advance
    else:
        yield _ProgressLog(label, unit, _LOG_PERIOD_SECONDS if log_seconds is None else log_seconds)


@contextmanager
def _terminal_progress_bar(label: str, unit: str) -> Iterator[ProgressCallback]:
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
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=None, rate="", remark="")

        def advance(done: int, total: int, remark: str = "") -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed * 60:.1f} {unit}/min" if speed else ""
            bar.update(task, completed=done, total=total, rate=rate, remark=remark)

        yield advance


class _ProgressLog:
    """Writes a line of progress to stderr every `seconds`."""

    def __init__(self, label: str, unit: str, seconds: float) -> None:
        self._label, self._unit, self._seconds = label, unit, seconds
        self._written = time.monotonic()
        # Time (s) and finished items at the first call; the rate excludes these items: a resumed job has many.
        self._first: tuple[float, int] | None = None

    def __call__(self, done: int, total: int, remark: str = "") -> None:
        now = time.monotonic()
        self._first = self._first or (now, done)
        if now - self._written < self._seconds:
            return
        self._written = now
        parts = [f"{self._label}: {done} of {total} {self._unit}", *self._rate_and_time_left(now, done, total), remark]
        print_note(", ".join(part for part in parts if part))

    def _rate_and_time_left(self, now: float, done: int, total: int) -> tuple[str, ...]:
        assert self._first is not None
        began, before = self._first
        if done <= before or now <= began:
            return ()
        rate = (done - before) / (now - began)
        return f"{rate * 60:.1f} {self._unit}/min", f"{timedelta(seconds=round((total - done) / rate))} left"
