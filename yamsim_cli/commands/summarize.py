"""`yamsim summarize`: a dataset's statistics, and whether it is whole."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.core.errors import DatasetError, UsageError

from .console import print_json, print_table, progress_bar
from .session import Json

# Source: the lab reports both.
_THRESHOLDS = (0.05, 0.08)

# More would only repeat the fault; --json has them all.
_SHOWN_PROBLEMS = 20


def summarize(
    dataset: Annotated[Path, typer.Argument(help="The directory that `yamsim record` wrote.", show_default=False)],
    threshold: Annotated[
        list[float] | None, typer.Option(help="Score by this distance in m; may be given again.  [default: 0.05, 0.08]")
    ] = None,
    json: Json = False,
) -> None:
    """Open every file of a dataset, count, and name what is wrong. Exit code 4 if anything is.

    Example: yamsim summarize dataset/ --json
    """
    for value in threshold or ():
        if not value > 0:
            raise UsageError(f"--threshold {value:g} is not valid: give a distance in metres above 0")

    from yamsim_cli.core.dataset.summary import summarize as run
    from yamsim_cli.core.vision.jpeg import decode_jpeg

    with progress_bar("checking", "episodes") as advance:
        report = run(dataset, threshold or _THRESHOLDS, decode_jpeg, lambda done, total: advance(done, total, ""))
    if json:
        print_json(report)
    else:
        print_table(_table(report))
    if report["problems"]:
        raise DatasetError(_verdict(dataset, report["problems"]))


def _table(report: dict[str, Any]) -> object:
    from rich.table import Table

    table = Table("dataset", report["path"])
    table.add_row("episodes, frames", f"{report['episodes']}, {report['frames']}")
    table.add_row("size", f"{report['bytes'] / 1e6:.1f} MB")
    table.add_row("cameras", ", ".join(f"{name} {w}x{h}" for name, (w, h) in report["cameras"].items()))
    table.add_row("task, grasp", f"{', '.join(report['tasks'])}; {', '.join(report['grasps'])}")
    for limit, rate in report["success_rate"].items():
        if rate is not None:
            low, high = report["wilson95"][limit]
            table.add_row(
                f"episodes within {float(limit) * 100:g} cm", f"{rate:.1%} (95 % interval {low:.1%} to {high:.1%})"
            )
    attempts = report["attempts"]
    if attempts["n"]:
        causes = "".join(f", {count} {cause}" for cause, count in attempts["causes"].items())
        low, high = attempts["wilson95"]
        table.add_row("attempts", f"{attempts['n']}: {attempts['success_rate']:.1%} ({low:.1%} to {high:.1%}){causes}")
    for key, label in (("dxy_m", "distance from the centre"), ("dz_m", "height over the target")):
        if spread := report[key]:
            table.add_row(label, ", ".join(f"{name} {value * 1000:.1f} mm" for name, value in spread.items()))
    for name, axes in report["workspace"].items():
        table.add_row(
            f"{name} starts at", ", ".join(f"{axis} {low:.2f}..{high:.2f} m" for axis, (low, high) in axes.items())
        )
    for problem in report["problems"][:_SHOWN_PROBLEMS]:
        table.add_row("[red]problem[/red]", f"{_place(problem)}: {problem['problem']}")
    if len(report["problems"]) > _SHOWN_PROBLEMS:
        table.add_row("", f"and {len(report['problems']) - _SHOWN_PROBLEMS} more: see --json")
    if not report["problems"]:
        table.add_row("problems", "none: every file was opened and is as it was recorded")
    return table


def _place(problem: dict[str, str]) -> str:
    return "/".join(part for part in (problem["episode"], problem["file"]) if part) or "dataset"


def _verdict(dataset: Path, problems: list[dict[str, str]]) -> str:
    first = problems[0]
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{dataset}: {_place(first)}: {first['problem']}{more}; do not train on it before that is mended"
