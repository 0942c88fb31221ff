from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.core.errors import PartialJobError, UsageError, count_noun
from yamsim_cli.flags.output_files import Overwrite, require_unused
from yamsim_cli.flags.session_options import Json
from yamsim_cli.terminal.console import print_json, print_line


def review(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="DATASET", help="A dataset; with --merge two selections.", show_default=False),
    ],
    merge: Annotated[bool, typer.Option("--merge", help="Merge the selections of two reviewers into --out.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The selection to write.", show_default=False)
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Merge the decisions of two reviewers. Exit code 6 if they disagree: those episodes stay undecided.

    Example: yamsim review --merge ann.yaml bob.yaml --out selection.yaml
    """
    _merge(paths, out, overwrite, json)


def _merge(paths: list[Path], out: Path | None, overwrite: bool, json: bool) -> None:
    if len(paths) != 2:
        raise UsageError(f"--merge takes two selections, not {len(paths)}: give A.yaml B.yaml")
    if out is None:
        raise UsageError("--merge needs --out FILE, the merged selection")
    require_unused("--out", out, overwrite=overwrite)

    from yamsim_cli.core.files.writing import write_output
    from yamsim_cli.selection import merge_selections, read_selection, selection_text

    merged, conflicts = merge_selections(read_selection(paths[0]), read_selection(paths[1]))
    write_output(out, selection_text(merged).encode())
    if json:
        report = {"path": str(out), "episodes": len(merged.decisions)}
        print_json(report | {"conflicts": [asdict(conflict) for conflict in conflicts]})
    else:
        print_line(f"{count_noun(len(merged.decisions), 'decision')} in {out}")
        for conflict in conflicts:
            print_line(f"conflict in ep_{conflict.episode:06d}: {conflict.first}, and {conflict.second}")
    if conflicts:
        raise PartialJobError(
            f"{count_noun(len(conflicts), 'conflict')}: these episodes are undecided in {out}, first "
            f"ep_{conflicts[0].episode:06d}; decide them with `yamsim review`"
        )
