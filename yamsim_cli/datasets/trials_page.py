from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..core import plots
from ..core.config.goals.world import TABLE
from ..core.config.recording import RecordConfig
from ..core.markup import (
    Markup,
    captioned,
    grid_section,
    header_row,
    html_page,
    html_tag,
    key_figures,
    legend,
    percent,
    section,
    table_rows,
)
from ..core.plots import ObjectPlaces, Point, plot_workspace
from ..core.statistics import compute_coverage, histogram
from .check_summary import CELL_M

Box = tuple[Point, Point]


def start_boxes(config: RecordConfig) -> dict[str, Box]:
    """Return object -> x and y range of its start region on the table in `world`, m."""
    return {
        name: (start.x, start.y)
        for role, start in config.starts.items()
        if start.on == TABLE
        for name in config.task.possible_names(role)
    }


def trials_page(report: Mapping[str, Any], boxes: Mapping[str, Box], made: str) -> str:
    """Return the trials page as HTML.

    Args:
        boxes: object -> x and y range of its start region in `world`, m.
        made: text at the foot of the page.
    """
    good = [trial for trial in report["trials"] if trial["outcome"]["success"]]
    failed = [trial for trial in report["trials"] if not trial["outcome"]["success"]]
    body = [
        _figures(report),
        _success(report),
        _goal(report["trials"]),
        _workspace(good, failed, boxes),
        _failures(failed),
    ]
    heading = f"{report['task']} on {report['rig']}, grasp {report['grasp']}"
    return html_page(f"{report['task']}: trials", "Trials", heading, body, made)


def _figures(report: Mapping[str, Any]) -> Markup:
    low, high = report["wilson95"]
    within = "success" if report["threshold_m"] is None else f"within {report['threshold_m'] * 100:g} cm"
    figures = [
        (f"{report['n']:,}", "trials"),
        (percent(report["success_rate"]), f"{within} ({percent(low)} to {percent(high)})"),
    ]
    if spread := report["dxy_m"]:
        figures.append((f"{spread['median'] * 1000:.1f} mm", "median distance from the target's centre"))
    if report["recovered"]:
        figures.append((f"{report['recovered']:,}", "of the successes tried a skill again"))
    if margins := report["margins"]:
        figures += [
            (percent(margins["velocity_share"], 0), "of a motor's speed at most"),
            (percent(margins["torque_share"], 0), "of a drive's torque at most"),
            (f"{margins['joint_rad']:.2f} rad", "from a joint limit at least"),
        ]
    return key_figures(figures)


def _success(report: Mapping[str, Any]) -> Markup | None:
    distances = [trial["outcome"]["dxy_m"] for trial in report["trials"] if trial["outcome"]["dxy_m"] is not None]
    figures = []
    if found := histogram(distances):
        title = "Distance from the target's centre"
        picture = plots.plot_distances(found["edges"], found["counts"], [report["threshold_m"]], title, "trials")
        spread = report["dxy_m"]
        caption = f"Median {spread['median'] * 1000:.1f} mm, largest {spread['max'] * 1000:.1f} mm."
        figures.append(captioned(title, picture, caption))
    if causes := report["causes"]:
        caption = f"{sum(causes.values()):,} of {report['n']:,} trials failed."
        figures.append(captioned("Failures by cause", plots.plot_failures(causes), caption))
    return grid_section("Success", figures, "columns")


def _goal(trials: Sequence[Mapping[str, Any]]) -> Markup | None:
    measures: dict[str, list[Mapping[str, Any]]] = {}
    for trial in trials:
        for measure in trial["outcome"].get("measures") or ():
            measures.setdefault(measure["what"], []).append(measure)
    if not measures:
        return None
    head = header_row(("", "held", "least margin where it held"))
    cells = table_rows(_measured(what, found) for what, found in measures.items())
    return section("Goal", html_tag("table", html_tag("tbody", head, cells)))


def _measured(what: str, found: Sequence[Mapping[str, Any]]) -> tuple[str, str, str]:
    held = [one["margin"] for one in found if one["margin"] >= 0]
    scale, unit = (1000, "mm") if found[0]["unit"] == "m" else (1, found[0]["unit"])
    return what, f"{len(held):,} of {len(found):,}", f"{min(held) * scale:.3g} {unit}" if held else ""


def _workspace(
    good: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]], boxes: Mapping[str, Box]
) -> Markup | None:
    panels = []
    for name in dict.fromkeys(name for trial in (*good, *failed) for name in trial["layout"]):
        succeeded, others = (
            [_start(trial, name) for trial in trials if name in trial["layout"]] for trials in (good, failed)
        )
        box, title = boxes.get(name), f"{name}, start"
        grid = compute_coverage(succeeded, *box, CELL_M) if box else None
        caption = f"{grid.cells_hit} of {grid.cells} cells with a success" if grid else "it starts on another object"
        panels.append(
            captioned(title, plot_workspace(ObjectPlaces(succeeded, (), others, grid), box, "world", title), caption)
        )
    entries = [
        (None, "success"),
        *([("failed", "failure")] if failed else []),
        ("cell", f"cell of {CELL_M * 100:g} cm with a success"),
    ]
    return grid_section("Workspace", panels, "plans", legend(entries))


def _start(trial: Mapping[str, Any], name: str) -> Point:
    x, y, *_ = trial["layout"][name]
    return x, y


def _failures(failed: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not failed:
        return None
    outcomes = [(str(trial["trial"]), trial["outcome"]) for trial in failed]
    cells = table_rows((number, outcome["cause"], outcome["detail"]) for number, outcome in outcomes)
    return section("Failures", html_tag("table", html_tag("tbody", cells)))
