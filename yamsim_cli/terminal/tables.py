"""Tables for a terminal of any width: long cells wrap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, JustifyMethod, RenderResult
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

_MIN_WIDE_COLUMNS = 60  # characters; the cells of a row may be stacked in a narrower terminal
_MAX_NAME_SHARE = 0.4  # of a narrow terminal's width; longer names have their values below

Item = Mapping[str, Any]


class NameValueTable:
    """Table of names and values; narrow terminals show values below long names."""

    def __init__(self, rows: Iterable[tuple[str | Text, str | Text]]) -> None:
        self._rows = [(_plain_text(name), _plain_text(value)) for name, value in rows]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widest = max((name.cell_len for name, _ in self._rows), default=0)
        if options.max_width >= _MIN_WIDE_COLUMNS or widest <= _MAX_NAME_SHARE * options.max_width:
            from rich.table import Table

            table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), pad_edge=False)
            table.add_column(style="dim", no_wrap=True)
            table.add_column(overflow="fold")
            for row in self._rows:
                table.add_row(*row)
            yield table
            return
        for name, value in self._rows:
            yield name
            yield _indent_block(value)


class ItemTable:
    """Table with one item in each row, or a stacked list where columns would break words.

    Args:
        numbers_from, numbers_to: the columns from `numbers_from` to `numbers_to` - 1, from 0, are aligned right.
        whole: whether cells of the first column never wrap.
    """

    def __init__(
        self,
        headings: Sequence[str],
        title: str | None = None,
        numbers_from: int = 1,
        numbers_to: int = 99,
        *,
        whole: bool = False,
    ) -> None:
        self._headings, self._title, self._whole = headings, title, whole
        self._numbers = range(numbers_from, numbers_to)
        self._rows: list[list[Text]] = []

    def add_row(self, *cells: str | Text) -> None:
        """Add a row, with one cell for each column."""
        self._rows.append([_plain_text(cell) for cell in cells])

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        table = self._rich_table()
        if options.max_width >= _MIN_WIDE_COLUMNS or self._narrowest_width() <= options.max_width:
            yield table
            return
        if self._title:
            from rich.text import Text

            yield Text(f"\n{self._title}", style="bold")
        for first, *others in self._rows:
            yield first
            named = zip(self._headings[1:], others, strict=True)
            yield _indent_block(NameValueTable((name, cell) for name, cell in named if cell.plain))

    def _narrowest_width(self) -> int:
        columns = zip(map(_plain_text, self._headings), *self._rows, strict=True)
        return sum(max(len(word) for cell in column for word in (cell.plain.split() or [""])) + 3 for column in columns)

    def _rich_table(self) -> Table:
        from rich import box
        from rich.table import Table

        table = Table(box=box.SIMPLE, title=self._title, title_justify="left", title_style="bold", pad_edge=False)
        for k, heading in enumerate(self._headings):
            justify: JustifyMethod = "right" if k in self._numbers else "left"
            table.add_column(heading, justify=justify, overflow="fold", no_wrap=self._whole and k == 0)
        for row in self._rows:
            table.add_row(*row)
        return table


def print_items(
    items: Sequence[Item], headings: Sequence[str], row: Callable[[Item], Sequence[str]], json: bool
) -> None:
    """Print items to stdout: as the JSON object `{"items": [...]}`, or as a table."""
    from .console import print_json, print_table

    if json:
        print_json({"items": list(items)})
        return
    table = ItemTable(headings, numbers_from=len(headings))
    for item in items:
        table.add_row(*row(item))
    print_table(table)


def print_item(item: Item, json: bool, words: Mapping[str, Callable[[Any], str]] | None = None) -> None:
    """Print an item to stdout: as JSON `{"items": [item]}`, or as a table of keys and values.

    `words` has functions that format a key's value; the default is `format_value`.
    """
    from .console import print_json, print_table

    if json:
        print_json({"items": [item]})
        return
    known_words = words or {}
    known = {key: value for key, value in item.items() if value is not None and value != []}
    print_table(
        NameValueTable(
            (key.replace("_", " "), known_words.get(key, format_value)(value)) for key, value in known.items()
        )
    )


def format_value(value: Any) -> str:
    """Return a JSON value as text for users, such as "yes" for true and "a, b" for a list."""
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {format_value(inner)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(format_value, value))
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)


def _indent_block(what: Text | NameValueTable) -> Padding:
    from rich.padding import Padding

    return Padding(what, (0, 0, 0, 2))


def _plain_text(cell: str | Text) -> Text:
    """Return the cell as text that wraps and is not parsed as markup, because a path may contain brackets."""
    from rich.text import Text

    text = Text(cell) if isinstance(cell, str) else cell.copy()
    text.overflow = "fold"
    return text
