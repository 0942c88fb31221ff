"""The two shapes of tables that commands print. Both fold long cells rather than cut them, and fit 80 columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text


def facts(rows: Iterable[tuple[str | Text, str | Text]], title: str | None = None) -> Table:
    """One thing's figures: a name and a value a row."""
    from rich.table import Table

    table = Table(
        box=None,
        show_header=False,
        pad_edge=False,
        padding=(0, 2, 0, 0),
        title=title,
        title_justify="left",
        title_style="bold",
    )
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(_plain(name), _plain(value))
    return table


def listing(headings: Sequence[str], title: str | None = None, numbers_from: int = 1) -> Table:
    """An empty table of many things.

    Args:
        headings: one a column.
        numbers_from: the first column of those that hold numbers, which are set flush right.
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE, title=title, title_justify="left", title_style="bold", pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="left" if k < numbers_from else "right", overflow="fold")
    return table


def file_size(size: float) -> str:
    """A number of bytes for a person."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size / 1e3:.1f} kB"


def _plain(cell: str | Text) -> Text:
    """Never markup: a path may hold brackets."""
    from rich.text import Text

    return Text(cell) if isinstance(cell, str) else cell
