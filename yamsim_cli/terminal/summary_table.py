from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.constrain import Constrain
from rich.text import Text

from yamsim_cli.core.dataset.checks.problem import printable_line
from yamsim_cli.core.errors import file_size
from yamsim_cli.datasets.dataset_page import group_by_code, problem_counts

from .tables import ItemTable, NameValueTable

_WIDTH = 80  # terminal columns
_MAX_EXAMPLES = 2  # for each problem code; --json has all
_MAX_EXAMPLE_LENGTH = 200  # characters
_STATISTIC_LABELS = {"median": "median", "p95": "95 %", "max": "most"}  # statistic in the report -> label


def summary_tables(report: Mapping[str, Any]) -> RenderableType:
    """Return tables of a dataset summary: figures, success rates by threshold, workspace, and problems by code."""
    parts: list[RenderableType] = [_figure_table(report)]
    if report["episodes"] and not report["real"]:
        parts += [
            *([_success_rate_table(report)] if report["success_rate"] else []),
            _workspace_table(report["workspace"]),
        ]
    parts.append(_problem_view(report))
    return Constrain(Group(*parts), _WIDTH)


def _figure_table(report: Mapping[str, Any]) -> NameValueTable:
    rows: list[tuple[str, str]] = []

    def add_row(name: str, value: str) -> None:
        if value:
            rows.append((name, printable_line(value)))

    add_row("dataset", report["path"])
    add_row("source", "real: imported, not simulated" if report["real"] else "")
    add_row("episodes", f"{report['episodes']:,}: {report['frames']:,} frames, {_duration(report['seconds'])}")
    each = report["bytes_per_episode"]
    add_row("size", file_size(report["bytes"]) + (f", {file_size(each['median'])} an episode" if each else ""))
    add_row("cameras", ", ".join(f"{name} {w}x{h}" for name, (w, h) in report["cameras"].items()))
    noted = report["noted_at_import"]
    add_row("noted at import", "; ".join(f"{name}: {line}" for name, lines in noted.items() for line in lines[:1]))
    add_row("task, grasp", "; ".join(", ".join(names) for names in (report["tasks"], report["grasps"]) if names))
    attempts = report["attempts"]
    if attempts["n"]:
        add_row(
            "attempts", f"{attempts['n']:,}: {_rate_text(attempts['success_rate'], attempts['wilson95'])} succeeded"
        )
        add_row("failures", ", ".join(f"{count} {cause}" for cause, count in attempts["causes"].items()))
        if attempts["recovered"]:
            add_row("recovered", f"{attempts['recovered']:,} of them after a skill was tried again")
    for key, label in (("dxy_m", "off centre"), ("dz_m", "above target")):
        if spread := report[key]:
            add_row(label, ", ".join(f"{name} {spread[k] * 1000:.1f} mm" for k, name in _STATISTIC_LABELS.items()))
    return NameValueTable(rows)


def _success_rate_table(report: Mapping[str, Any]) -> ItemTable:
    attempts = report["attempts"]
    table = ItemTable(["within", "episodes", *(["all attempts"] if attempts["n"] else [])], title="Success")
    for limit, rate in report["success_rate"].items():
        cells = [_rate_text(rate, report["wilson95"][limit])]
        if attempts["n"]:
            cells.append(_rate_text(attempts["rates"][limit], attempts["rates_wilson95"][limit]))
        table.add_row(f"{float(limit) * 100:g} cm", *cells)
    return table


def _workspace_table(workspace: Mapping[str, Any]) -> ItemTable:
    table = ItemTable(["m", "x", "y", "cells hit", "outside"], title="Workspace")
    if found := workspace["box"]:
        table.add_row("sampled from", _span(found["x"]), _span(found["y"]), "", "")
    for name, ends in workspace["objects"].items():
        for when in ("start", "end"):
            if place := ends[when]:
                cells = f"{place['cells_hit']} of {place['cells']}" if "cells" in place else ""
                table.add_row(
                    Text(f"{name}, {when}"), _span(place["x"]), _span(place["y"]), cells, str(place.get("outside", ""))
                )
    return table


def _problem_view(report: Mapping[str, Any]) -> RenderableType:
    if not report["problems"]:
        return Text("No problems: every file was opened and is valid.", style="green")
    title = ", ".join(problem_counts(report))
    table = ItemTable(["problem", "times", "what, where, and what to do"], title, numbers_to=2, whole=True)
    for code, problems in group_by_code(report["problems"]):
        style = "red" if problems[0]["severity"] == "error" else "yellow"
        table.add_row(Text(code, style=style), f"{len(problems):,}", _problem_examples(problems))
    return table


def _problem_examples(problems: Sequence[Mapping[str, Any]]) -> Text:
    text = Text()
    for problem in problems[:_MAX_EXAMPLES]:
        place = "/".join(part for part in (problem["episode"], problem["file"]) if part)
        line = f"{place}: {problem['problem']}" if place else problem["problem"]
        text.append(line if len(line) <= _MAX_EXAMPLE_LENGTH else line[: _MAX_EXAMPLE_LENGTH - 3] + "...")
        text.append("\n")
    if len(problems) > _MAX_EXAMPLES:
        text.append(f"and {len(problems) - _MAX_EXAMPLES:,} more\n")
    return text.append(problems[0]["advice"], style="dim")


def _rate_text(rate: float | None, interval: Sequence[float]) -> str:
    return "none" if rate is None else f"{rate:.1%} ({interval[0]:.1%} to {interval[1]:.1%})"


def _span(span: Sequence[float]) -> str:
    return f"{span[0]:.2f} to {span[1]:.2f}"


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"
