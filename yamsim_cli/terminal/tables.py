"""The two shapes of tables that commands print. Both fold long cells rather than cut them, and fit any terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, JustifyMethod, RenderResult
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

# In a narrower terminal, cells may stand below one another instead of in columns.
_NARROW = 60
# Largest share of a narrow terminal's width at which names still stand beside their values.
_NAMES = 0.4


class Facts:
    """One thing's figures: a name and a value a row; in a narrow terminal, values stand under long names."""

    def __init__(self, rows: Iterable[tuple[str | Text, str | Text]], title: str | None = None) -> None:
        self._rows = [(_plain(name), _plain(value)) for name, value in rows]
        self._title = title

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widest = max((name.cell_len for name, _ in self._rows), default=0)
        if options.max_width >= _NARROW or widest <= _NAMES * options.max_width:
            yield _side_by_side(self._rows, self._title)
            return
        if self._title:
            yield _heading(self._title)
        for name, value in self._rows:
            yield name
            yield _indented(value)


class Listing:
    """Many things, one a row; in a narrow terminal whose columns would break words, one below the other.

    Args:
        headings: one a column.
        numbers: the columns that hold numbers, which are set flush right.
        whole: whether the first column is never broken into lines.
    """

    def __init__(self, headings: Sequence[str], title: str | None, numbers: range, whole: bool) -> None:
        self._headings, self._title, self._numbers, self._whole = headings, title, numbers, whole
        self._rows: list[list[Text]] = []

    def add_row(self, *cells: str | Text) -> None:
        """Add one thing's cells, one a column."""
        self._rows.append([_plain(cell) for cell in cells])

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        table = self._table()
        if options.max_width >= _NARROW or self._narrowest() <= options.max_width:
            yield table
            return
        if self._title:
            yield _heading(self._title)
        for first, *others in self._rows:
            yield first
            named = zip(self._headings[1:], others, strict=True)
            yield _indented(Facts((name, cell) for name, cell in named if cell.plain))

    def _narrowest(self) -> int:
        """The table's width if lines are broken only between words."""
        columns = zip(map(_plain, self._headings), *self._rows, strict=True)
        return sum(max(len(word) for cell in column for word in (cell.plain.split() or [""])) + 3 for column in columns)

    def _table(self) -> Table:
        from rich import box
        from rich.table import Table

        table = Table(box=box.SIMPLE, title=self._title, title_justify="left", title_style="bold", pad_edge=False)
        for k, heading in enumerate(self._headings):
            justify: JustifyMethod = "right" if k in self._numbers else "left"
            table.add_column(heading, justify=justify, overflow="fold", no_wrap=self._whole and k == 0)
        for row in self._rows:
            table.add_row(*row)
        return table


def facts(rows: Iterable[tuple[str | Text, str | Text]], title: str | None = None) -> Facts:
    """One thing's figures: a name and a value a row."""
    return Facts(rows, title)


def listing(
    headings: Sequence[str],
    title: str | None = None,
    numbers_from: int = 1,
    numbers_to: int = 99,
    *,
    whole: bool = False,
) -> Listing:
    """An empty table of many things.

    Args:
        headings: one a column.
        numbers_from, numbers_to: the first column of those that hold numbers, and the first one after them.
        whole: see `Listing`.
    """
    return Listing(headings, title, range(numbers_from, numbers_to), whole)


def file_size(size: float) -> str:
    """A number of bytes for a person."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size / 1e3:.1f} kB"


def _side_by_side(rows: Iterable[tuple[Text, Text]], title: str | None) -> Table:
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
        table.add_row(name, value)
    return table


def _heading(text: str) -> Text:
    from rich.text import Text

    return Text(f"\n{text}", style="bold")


def _indented(what: Text | Facts) -> Padding:
    from rich.padding import Padding

    return Padding(what, (0, 0, 0, 2))


def _plain(cell: str | Text) -> Text:
    """The cell as text that is folded where it is too long. It is never read as markup: a path may hold brackets."""
    from rich.text import Text

    text = Text(cell) if isinstance(cell, str) else cell.copy()
    text.overflow = "fold"
    return text
