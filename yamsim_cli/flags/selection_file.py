"""The flag `--selection`: leave out episodes that a person dropped."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.terminal.console import print_note

if TYPE_CHECKING:
    from yamsim_cli.selection import AppliedSelection

SelectionFile = Annotated[
    Path | None,
    typer.Option(
        "--selection", metavar="FILE", help="Leave out what a person dropped: the selection.yaml of `yamsim review`."
    ),
]


def selection_of(dataset: Path, file: Path | None) -> AppliedSelection | None:
    """Compare a selection with its dataset, and print what the selection leaves out; None without a file."""
    if file is None:
        return None
    from yamsim_cli.selection import apply_selection

    applied = apply_selection(dataset, file)
    print_note(f"{applied.summary()}.")
    return applied
