from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.selection_file import SelectionFile, selection_of
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_note, print_report, progress_bar


def summarize(
    dataset: Annotated[Path, typer.Argument(help="The directory that `yamsim record` wrote.", show_default=False)],
    threshold: Annotated[
        list[float] | None,
        typer.Option(help="Distance in m that counts as a success; may be repeated.  [default: 0.05 and 0.08]"),
    ] = None,
    selection: SelectionFile = None,
    html: Annotated[Path | None, typer.Option(help="Also write a report with plots and pictures, one page.")] = None,
    overwrite: Overwrite = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 4 for warnings too.")] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Number of processes that read files.  [default: one a core]")
    ] = None,
    json: Json = False,
) -> None:
    """Check all files of a dataset, and report statistics and problems. Exit code 4 for errors; warnings need --strict.

    With --selection, figures and problems are for the kept episodes. Trimmed episodes count as a whole.

    Example: yamsim summarize dataset/ --threshold 0.03 --html report.html
    """
    for value in threshold or ():
        if not 0 < value < math.inf:
            raise UsageError(f"--threshold {value:g} is not valid: give a distance in metres above 0")
    if html:
        require_unused_paths("--html", html, overwrite=overwrite)

    from yamsim_cli.core.statistics import THRESHOLDS
    from yamsim_cli.cpu_limits import usable_cores
    from yamsim_cli.datasets.check_summary import summarize_checks as count
    from yamsim_cli.datasets.summarize import check_dataset

    thresholds = sorted(set(threshold or THRESHOLDS))
    applied = selection_of(dataset, selection)
    with progress_bar("checking", "episodes") as advance:
        results = check_dataset(dataset, session_opener.find_locations(), workers or usable_cores(), advance)
    if applied:
        results = results.restricted(applied.kept)
    report = count(results, thresholds) | {"selection": applied and applied.report()}
    if html:
        from yamsim_cli.datasets.summarize import write_report

        write_report(results, report, html)
        report["html"] = str(html)
    from yamsim_cli.terminal.summary_table import summary_tables

    print_report(report, lambda: summary_tables(report), json)
    if html and not json:
        print_note(f"The report is in {html}.")
    if report["errors"] or (strict and report["warnings"]):
        raise DatasetError(_verdict_line(dataset, report, strict))


def _verdict_line(dataset: Path, report: dict[str, Any], strict: bool) -> str:
    problems = [problem for problem in report["problems"] if strict or problem["severity"] == "error"]
    first = problems[0]
    place = "/".join(part for part in (first["episode"], first["file"]) if part)
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{dataset}: {place + ': ' if place else ''}{first['problem']} [{first['code']}]{more}; {first['advice']}"
