"""The flags `--selection` and `--who`: leave out episodes that a person dropped, and frames by who acted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.correction_record import Actor
from yamsim_cli.terminal.console import print_note

if TYPE_CHECKING:
    from yamsim_cli.selection import AppliedSelection

SelectionFile = Annotated[
    Path | None,
    typer.Option(
        "--selection",
        metavar="FILE",
        help="Leave out episodes that a person dropped: the selection.yaml of `yamsim review`.",
    ),
]
Who = Annotated[
    Actor | None,
    typer.Option(
        "--who", help="Only the frames in which the expert acts, or the policy, in a dataset of `yamsim correct`."
    ),
]


def selection_of(dataset: Path, file: Path | None, who: Actor | None = None) -> AppliedSelection | None:
    """Compare a selection with its dataset, and print what the selection leaves out; None without a file and `who`."""
    if file is None and who is None:
        return None
    from yamsim_cli.selection import apply_selection, select_actor

    applied = None
    if file is not None:
        applied = apply_selection(dataset, file)
        print_note(f"{applied.summary()}.")
    return select_actor(dataset, who, applied) if who else applied
