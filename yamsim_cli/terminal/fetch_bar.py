from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from yamsim_cli.core.errors import file_size


class FetchBar(Protocol):
    """Shows the progress of a download, or of a reduction of meshes."""

    def __call__(self, label: str, done: int, total: int, /, shown: str = "") -> None:
        """Show `done` of `total` bytes, or the text `shown` instead."""


@contextmanager
def fetch_bar() -> Iterator[FetchBar]:
    """Yield a function that updates a progress bar on stderr, without effect outside a terminal."""
    from rich.progress import BarColumn, Progress, TextColumn

    from .console import console

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[done]}"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("meshes", total=None, done="")

        def advance(label: str, done: int, total: int, /, shown: str = "") -> None:
            text = shown or f"{file_size(done)} of {file_size(total)}"
            bar.update(task, description=label, completed=done, total=total, done=text)

        yield advance
