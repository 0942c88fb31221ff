from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .. import plots
from ..core.config.goals.world import TABLE
from ..core.config.recording import RecordConfig
from ..core.markup import (
    Markup,
    captioned_plot,
    grid_section,
    header_row,
    html_page,
    html_section,
    html_tag,
    key_figures,
    percent,
    plot_legend,
    table_rows,
)
from ..core.statistics import compute_coverage, compute_histogram
from ..plots import ObjectPlaces, Point, plot_workspace
from .check_summary import CELL_M

XyRegion = tuple[Point, Point]


def start_boxes(config: RecordConfig) -> dict[str, XyRegion]:
    """Return object -> x and y range of its start region on the table in `world`, m."""
    return {
        name: (start.x, start.y)
        for role, start in config.start_regions_in_world.items()
        if start.on == TABLE
        for name in config.task.possible_names(role)
    }


def trials_page(report: Mapping[str, Any], boxes: Mapping[str, XyRegion], made: str) -> str:
    """Return the trials page as HTML.

    Args:
        boxes: object -> x and y range of its start region in `world`, m.
        made: text at the foot of the page.
    """
    good = [trial for trial in report["trials"] if trial["outcome"]["success"]]
    failed = [trial for trial in report["trials"] if not trial["outcome"]["success"]]
    body = [
        _headline_figures(report),
        _success_section(report),
        _goal_section(report["trials"]),
        _workspace_section(good, failed, boxes),
        _failure_table(failed),
    ]
    heading = f"{report['task']} on {report['rig']}, grasp {report['grasp']}"
    return html_page(f"{report['task']}: trials", "Trials", heading, body, made)


def _headline_figures(report: Mapping[str, Any]) -> Markup:
    low, high = report["wilson95"]
    within = "success" if report["threshold_m"] is None else f"within {report['threshold_m'] * 100:g} cm"
    figures = [
        (f"{report['n']:,}", "trials"),
        (percent(report["success_rate"]), f"{within} ({percent(low)} to {percent(high)})"),
    ]
    if spread := report["dxy_m"]:
        figures.append((f"{spread['median'] * 1000:.1f} mm", "median distance from the target's centre"))
    if report["recovered"]:
        figures.append((f"{report['recovered']:,}", "successes in which a skill was tried again"))
    if margins := report["margins"]:
        figures += [
            (percent(margins["velocity_share"], 0), "largest share of a motor's speed"),
            (percent(margins["torque_share"], 0), "largest share of a drive's torque"),
            (f"{margins['joint_rad']:.2f} rad", "smallest distance from a joint limit"),
        ]
    return key_figures(figures)


def _success_section(report: Mapping[str, Any]) -> Markup | None:
    distances = [trial["outcome"]["dxy_m"] for trial in report["trials"] if trial["outcome"]["dxy_m"] is not None]
    figures = []
    if found := compute_histogram(distances):
        title = "Distance from the target's centre"
        picture = plots.plot_distance_histogram(
            found["edges"], found["counts"], [report["threshold_m"]], title, "trials"
        )
        spread = report["dxy_m"]
        caption = f"Median {spread['median'] * 1000:.1f} mm, largest {spread['max'] * 1000:.1f} mm."
        figures.append(captioned_plot(title, picture, caption))
    if causes := report["causes"]:
        caption = f"{sum(causes.values()):,} of {report['n']:,} trials failed."
        figures.append(captioned_plot("Failures by cause", plots.plot_failures(causes), caption))
    return grid_section("Success", figures, "columns")


def _goal_section(trials: Sequence[Mapping[str, Any]]) -> Markup | None:
    measures: dict[str, list[Mapping[str, Any]]] = {}
    for trial in trials:
        for measure in trial["outcome"].get("measures") or ():
            measures.setdefault(measure["what"], []).append(measure)
    if not measures:
        return None
    head = header_row(("", "held", "smallest margin of trials in which it held"))
    cells = table_rows(_measure_row(what, found) for what, found in measures.items())
    return html_section("Goal", html_tag("table", html_tag("tbody", head, cells)))


def _measure_row(what: str, found: Sequence[Mapping[str, Any]]) -> tuple[str, str, str]:
    held = [one["margin"] for one in found if one["margin"] >= 0]
    scale, unit = (1000, "mm") if found[0]["unit"] == "m" else (1, found[0]["unit"])
    return what, f"{len(held):,} of {len(found):,}", f"{min(held) * scale:.3g} {unit}" if held else ""


def _workspace_section(
    good: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]], boxes: Mapping[str, XyRegion]
) -> Markup | None:
    panels = []
    for name in dict.fromkeys(name for trial in (*good, *failed) for name in trial["layout"]):
        succeeded, others = (
            [_start_position(trial, name) for trial in trials if name in trial["layout"]] for trials in (good, failed)
        )
        box, title = boxes.get(name), f"{name}, start"
        grid = compute_coverage(succeeded, *box, CELL_M) if box else None
        caption = (
            f"{grid.hit_cell_count} of {grid.cell_count} cells with a success"
            if grid
            else "it starts on another object"
        )
        panels.append(
            captioned_plot(
                title, plot_workspace(ObjectPlaces(succeeded, (), others, grid), box, "world", title), caption
            )
        )
    entries = [
        (None, "success"),
        *([("failed", "failure")] if failed else []),
        ("cell", f"cell of {CELL_M * 100:g} cm with a success"),
    ]
    return grid_section("Workspace", panels, "plans", plot_legend(entries))


def _start_position(trial: Mapping[str, Any], name: str) -> Point:
    x, y, *_ = trial["layout"][name]
    return x, y


def _failure_table(failed: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not failed:
        return None
    outcomes = [(str(trial["trial"]), trial["outcome"]) for trial in failed]
    cells = table_rows((number, outcome["cause"], outcome["detail"]) for number, outcome in outcomes)
    return html_section("Failures", html_tag("table", html_tag("tbody", cells)))
