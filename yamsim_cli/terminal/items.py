"""How commands tell of what there is: many things by a row each, one by all that is known of it, or both as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Item = Mapping[str, Any]


def print_items(
    items: Sequence[Item], headings: Sequence[str], row: Callable[[Item], Sequence[str]], json: bool
) -> None:
    """Print many things: `{"items": [...]}`, or a table.

    Args:
        row: the cells of an item, one a heading.
    """
    from .console import print_json, print_table
    from .tables import listing

    if json:
        print_json({"items": list(items)})
        return
    table = listing(headings, numbers_from=len(headings))
    for item in items:
        table.add_row(*row(item))
    print_table(table)


def print_item(item: Item, json: bool, words: Mapping[str, Callable[[Any], str]] | None = None) -> None:
    """Print one thing: `{"items": [...]}` as of many, or a key and its value a row, without those that say nothing.

    Args:
        words: key -> what a person is told of its value, where `in_words` is not enough.
    """
    from .console import print_json, print_table
    from .tables import facts

    if json:
        print_json({"items": [item]})
        return
    told = words or {}
    known = {key: value for key, value in item.items() if value is not None and value != []}
    print_table(facts((key.replace("_", " "), told.get(key, in_words)(value)) for key, value in known.items()))


def in_words(value: Any) -> str:
    """A JSON value for a person."""
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {in_words(inner)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(in_words, value))
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)
