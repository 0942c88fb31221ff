from __future__ import annotations

import getpass
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from yamsim_cli.core.errors import DatasetError, PartialJobError, UsageError, YamsimError, count_noun
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, print_result_now
from yamsim_cli.terminal.signals import defer_signals

_DEFAULT_PORT = 8091  # TCP port of the page
_POLL_SECONDS = 0.2  # s between looks whether a signal has arrived


def review(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="DATASET", help="A dataset; with --merge two selections.", show_default=False),
    ],
    merge: Annotated[bool, typer.Option("--merge", help="Merge the selections of two reviewers into --out.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The selection to write.  [default: DATASET/selection.yaml]"),
    ] = None,
    reviewer: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name in new decisions.  [default: the user's name]")
    ] = None,
    undecided: Annotated[
        Literal["keep", "drop"] | None,
        typer.Option(help="What --selection does with undecided episodes.  [default: as in the file, or keep]"),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Show the problems in a report of `yamsim summarize DATASET --json`."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help=f"Port of the page, {_DEFAULT_PORT} unless given; 0 takes a free one."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Look at a dataset on a page of this machine, and keep or drop its episodes. The dataset does not change.

    --merge merges the decisions of two reviewers instead. Where they disagree, episodes stay undecided, with exit code
    6.

    Example: yamsim review dataset/
    """
    if merge:
        _merge(paths, out, overwrite, json)
        return
    if len(paths) != 1:
        raise UsageError(f"yamsim review takes one dataset, not {len(paths)}; --merge takes two selections")
    if overwrite:
        raise UsageError("--overwrite is for --merge: a review continues its selection")
    _serve(paths[0], out, reviewer, undecided, report, _DEFAULT_PORT if port is None else port, json)


def _merge(paths: list[Path], out: Path | None, overwrite: bool, json: bool) -> None:
    if len(paths) != 2:
        raise UsageError(f"--merge takes two selections, not {len(paths)}: give A.yaml B.yaml")
    if out is None:
        raise UsageError("--merge needs --out FILE, the merged selection")
    require_unused_paths("--out", out, overwrite=overwrite)

    from yamsim_cli.core.dataset.dataset_paths import episode_name
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
            print_line(f"conflict in {episode_name(conflict.episode)}: {conflict.first}, and {conflict.second}")
    if conflicts:
        raise PartialJobError(
            f"{count_noun(len(conflicts), 'conflict')}: these episodes are undecided in {out}, first "
            f"{episode_name(conflicts[0].episode)}; decide them with `yamsim review`"
        )


def _serve(
    dataset: Path,
    out: Path | None,
    reviewer: str | None,
    undecided: Literal["keep", "drop"] | None,
    report: Path | None,
    port: int,
    json: bool,
) -> None:
    session_opener.disable_gl()

    from yamsim_cli.core.dataset.dataset_paths import episode_directories
    from yamsim_cli.core.dataset.reader import read_recorded_rig
    from yamsim_cli.review.decisions import DecisionFile
    from yamsim_cli.review.episode_index import read_problems, read_rows
    from yamsim_cli.review.page_server import ReviewServer
    from yamsim_cli.selection import SELECTION_FILE

    rows = read_rows(dataset, read_problems(report))
    if not rows:
        raise DatasetError(f"{dataset} holds no episodes yet; record some with `yamsim record`")
    directories = dict(episode_directories(dataset))
    try:
        rig = read_recorded_rig(dataset, session_opener.find_locations())
    except YamsimError as error:
        print_note(f"The page numbers the drives, because their names are unknown: {error}")
        rig = None
    with DecisionFile(out or dataset / SELECTION_FILE, dataset, directories, undecided) as decisions:
        if decisions.stale:
            print_note(
                f"{count_noun(len(decisions.stale), 'decision')} are stale, because the episodes have changed: "
                "they are undecided again"
            )
        name = _user_name() if reviewer is None else reviewer
        with (
            defer_signals() as stopped,
            ReviewServer(dataset, directories, rows, decisions, name, rig, port) as server,
        ):
            threading.Thread(target=server.serve_forever, daemon=True).start()
            data = {"url": server.url, "path": str(decisions.path), "episodes": len(rows)}
            print_result_now(data, f"{server.url}  (Ctrl-C ends; decisions are in {decisions.path})", json)
            waiting = threading.Event()
            while not stopped():
                waiting.wait(_POLL_SECONDS)
            server.shutdown()


def _user_name() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return ""
