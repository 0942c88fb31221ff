from __future__ import annotations

import getpass
import threading
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from yamsim_cli.core.errors import DatasetError, PartialJobError, UsageError, YamsimError, count_noun
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, print_result_now, progress_bar
from yamsim_cli.terminal.signals import defer_signals

if TYPE_CHECKING:
    from yamsim_cli.core.config.rig import RigConfig

_DEFAULT_PORT = 8091  # TCP port of the page
_POLL_SECONDS = 0.2  # s between looks whether a signal has arrived


def review(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATASET", help="A dataset; with --diff two, with --merge two selections.", show_default=False
        ),
    ],
    diff: Annotated[bool, typer.Option("--diff", help="Report the values in which two datasets differ.")] = False,
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
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Show the problems or the gap in a report of `yamsim summarize DATASET --json` or `yamsim gap DATASET "
            "--json`; may be repeated.",
        ),
    ] = None,
    motion: Annotated[
        bool, typer.Option("--motion", help="Read all frames first, for jerk, durations and joint ranges.")
    ] = False,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --diff: also write a page with plots and pictures.")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help=f"Port of the page, by default {_DEFAULT_PORT}; 0 selects a free port."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Look at a dataset on a page of this machine, and keep or drop its episodes. The dataset does not change.

    --merge merges the decisions of two reviewers instead. Where they disagree, episodes stay undecided, with exit code
    6. --diff compares two datasets instead: each value that both have is tested, with Holm's correction.

    Example: yamsim review dataset/
    """
    if merge and diff:
        raise UsageError("--merge and --diff exclude each other; give one of them")
    if html and not diff:
        raise UsageError("--html needs --diff: without --diff, `yamsim review` serves a page itself; leave --html out")
    if merge:
        _merge(paths, out, overwrite, json)
        return
    if diff:
        if out or report:
            raise UsageError(f"{'--out' if out else '--report'} is not for --diff; leave it out")
        _compare(paths, html, motion, overwrite, json)
        return
    if len(paths) != 1:
        raise UsageError(
            f"yamsim review takes one dataset, not {len(paths)}; --diff takes two, and --merge two selections"
        )
    if overwrite:
        raise UsageError("--overwrite needs --merge or --diff: a review adds to its selection; leave --overwrite out")
    dataset = paths[0]
    _require_dataset(dataset)
    _serve(dataset, out, reviewer, undecided, report or [], motion, _DEFAULT_PORT if port is None else port, json)


def _require_dataset(path: Path) -> None:
    """Refuse what is no folder, and recordings of other programs, with the command that imports them."""
    if not path.is_dir():
        raise DatasetError(f"{path} is not a folder; give the folder of a dataset")
    from yamsim_cli.core.dataset.imported_records import is_yamsim_data

    if is_yamsim_data(path) or any(path.glob("ep_*/episode.json")):
        return
    from yamsim_cli.real.recordings.motion_reading import detect_format

    try:
        found = detect_format(path)
    except YamsimError:
        return  # the reader of datasets reports the fault
    raise DatasetError(
        f"{path} is a recording ({found}) without hashes, so decisions on it could not be kept; import it with "
        f"`yamsim import {path} --rig RIG --out DIR`, and review DIR"
    )


def _read_rows(
    dataset: Path, more: dict[int, dict[str, Any]], rig: RigConfig | None, motion: bool
) -> list[dict[str, Any]]:
    """Return the rows of a dataset with `more` values and, with `motion`, the values of all frames."""
    from yamsim_cli.core.dataset.dataset_paths import episode_directories
    from yamsim_cli.review.episode_index import read_rows
    from yamsim_cli.review.episode_motion import MOTION_CACHE, read_motion

    if motion:
        cache = session_opener.find_locations().assets.parent / "review" / MOTION_CACHE
        with progress_bar("reading", "episodes") as advance:
            found = read_motion(dict(episode_directories(dataset)), rig, cache, dataset, advance)
        more = {number: more.get(number, {}) | found.get(number, {}) for number in more.keys() | found.keys()}
    rows = read_rows(dataset, more)
    if not rows:
        raise DatasetError(f"{dataset} holds no episodes yet; record some with `yamsim record`")
    return rows


def _read_rig(dataset: Path) -> RigConfig | None:
    from yamsim_cli.core.dataset.reader import read_recorded_rig

    try:
        return read_recorded_rig(dataset, session_opener.find_locations())
    except YamsimError as error:
        print_note(f"The drives of {dataset} are numbered, because their names are unknown: {error}")
        return None


def _compare(paths: list[Path], html: Path | None, motion: bool, overwrite: bool, json: bool) -> None:
    if len(paths) != 2:
        raise UsageError(f"--diff takes two datasets, not {len(paths)}: give their two folders")
    if html:
        require_unused_paths("--html", html, overwrite=overwrite)
    for path in paths:
        _require_dataset(path)

    from yamsim_cli.review.dataset_diff import compare_rows

    first, second = (_read_rows(path, {}, _read_rig(path) if motion else None, motion) for path in paths)
    difference = compare_rows(first, second)
    report: dict[str, Any] = {
        "datasets": [{"path": str(path), "episodes": len(of)} for path, of in zip(paths, (first, second), strict=True)],
        "differing": sum(column.differs for column in difference.columns),
        "values": [column.to_json_data() for column in difference.columns],
        "pairs": [list(pair) for pair in difference.pairs],
    }
    if html:
        from yamsim_cli.core.markup import write_page
        from yamsim_cli.review.diff_page import diff_page

        write_page(diff_page(difference, (first, second), (paths[0], paths[1])), html)
        report["html"] = str(html)
    if json:
        print_json(report)
        return
    for column in difference.columns:
        print_line(f"{'differs' if column.differs else '       '}  p {column.p_holm:<8.2g} {column.describe()}")
    print_line(
        f"{report['differing']} of {count_noun(len(difference.columns), 'value')} differ significantly; "
        f"{count_noun(len(difference.pairs), 'pair')} of episodes have the same seed and attempt"
    )
    if html:
        print_note(f"The page is in {html}.")


def _merge(paths: list[Path], out: Path | None, overwrite: bool, json: bool) -> None:
    if len(paths) != 2:
        raise UsageError(f"--merge takes two selections, not {len(paths)}: give two files, such as A.yaml B.yaml")
    if out is None:
        raise UsageError("--merge needs --out FILE, the file of the merged selection")
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
            f"{count_noun(len(conflicts), 'conflict')}, the first in {episode_name(conflicts[0].episode)}: the "
            f"episodes with conflicts are undecided in {out}; decide them with `yamsim review`"
        )


def _serve(
    dataset: Path,
    out: Path | None,
    reviewer: str | None,
    undecided: Literal["keep", "drop"] | None,
    reports: list[Path],
    motion: bool,
    port: int,
    json: bool,
) -> None:
    session_opener.disable_gl()

    from yamsim_cli.core.dataset.dataset_paths import episode_directories
    from yamsim_cli.review.decisions import DecisionFile
    from yamsim_cli.review.episode_index import read_reports
    from yamsim_cli.review.page_server import ReviewServer
    from yamsim_cli.selection import SELECTION_FILE

    more = read_reports(reports)
    rig = _read_rig(dataset)
    rows = _read_rows(dataset, more, rig, motion)
    directories = dict(episode_directories(dataset))
    with DecisionFile(out or dataset / SELECTION_FILE, dataset, directories, undecided) as decisions:
        if decisions.stale:
            print_note(
                f"{count_noun(len(decisions.stale), 'stale decision')}: these episodes have changed since they were "
                "decided, and are undecided again"
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
