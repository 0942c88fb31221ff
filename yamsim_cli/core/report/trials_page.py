"""A batch's report as one HTML page: its rates, how far goals were from failing, where things stood, and failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..config.recording import RecordConfig
from ..dataset.statistics import coverage, histogram
from ..dataset.summary import CELL_M
from ..goals.world import TABLE
from . import plots
from .axes import percent
from .markup import Markup, tag
from .page import captioned, document, figure
from .plan import Places, Point, workspace

Box = tuple[Point, Point]


def start_boxes(config: RecordConfig) -> dict[str, Box]:
    """Thing -> the box in `world` in which it starts, as x and y ranges, m; none of what starts on another thing."""
    return {
        name: (start.x, start.y)
        for role, start in config.starts.items()
        if start.on == TABLE
        for name in config.task.possible_names(role)
    }


def trials_page(report: Mapping[str, Any], boxes: Mapping[str, Box], made: str) -> str:
    """The page as HTML.

    Args:
        report: the report of `trials.run_batch`.
        boxes: see `start_boxes`.
        made: a line for the foot of the page: by what it was made, and when.
    """
    good = [trial for trial in report["trials"] if trial["outcome"]["success"]]
    failed = [trial for trial in report["trials"] if not trial["outcome"]["success"]]
    body = [
        tag("p", "Trials", class_="kicker"),
        tag("h1", f"{report['task']} on {report['rig']}, held by {report['grasp']}"),
        _figures(report),
        _success(report),
        _goal(report["trials"]),
        _workspace(good, failed, boxes),
        _failures(failed),
    ]
    return document(f"{report['task']}: trials", body, made)


def _figures(report: Mapping[str, Any]) -> Markup:
    low, high = report["wilson95"]
    within = "success" if report["threshold_m"] is None else f"within {report['threshold_m'] * 100:g} cm"
    limit = f"{within} ({percent(low)} to {percent(high)})"
    cells = [figure(f"{report['n']:,}", "trials"), figure(percent(report["success_rate"]), limit)]
    if spread := report["dxy_m"]:
        cells.append(figure(f"{spread['median'] * 1000:.1f} mm", "median distance from the target's centre"))
    if report["recovered"]:
        cells.append(figure(f"{report['recovered']:,}", "of the successes tried a skill again"))
    if margins := report["margins"]:
        cells += [
            figure(percent(margins["velocity_share"], 0), "of a motor's speed at most"),
            figure(percent(margins["torque_share"], 0), "of a drive's torque at most"),
            figure(f"{margins['joint_rad']:.2f} rad", "from a joint's stop at least"),
        ]
    return tag("div", cells, class_="figures")


def _success(report: Mapping[str, Any]) -> Markup | None:
    distances = [trial["outcome"]["dxy_m"] for trial in report["trials"] if trial["outcome"]["dxy_m"] is not None]
    figures = []
    if found := histogram(distances):
        title = "Distance from the target's centre"
        picture = plots.distances(found["edges"], found["counts"], [report["threshold_m"]], title, "trials")
        spread = report["dxy_m"]
        caption = f"Median {spread['median'] * 1000:.1f} mm, largest {spread['max'] * 1000:.1f} mm."
        figures.append(captioned(title, picture, caption))
    if causes := report["causes"]:
        count = sum(causes.values())
        caption = f"{count:,} of {report['n']:,} trials failed."
        figures.append(captioned("Failures by cause", plots.bars(causes), caption))
    if not figures:
        return None
    return tag("section", tag("h2", "Success"), tag("div", figures, class_="columns"))


def _goal(trials: Sequence[Mapping[str, Any]]) -> Markup | None:
    """A row for all that the goal asks for; None of tasks that have no goal of their own."""
    measures: dict[str, list[Mapping[str, Any]]] = {}
    for trial in trials:
        for measure in trial["outcome"].get("measures") or ():
            measures.setdefault(measure["what"], []).append(measure)
    if not measures:
        return None
    head = tag("tr", [tag("th", text, scope="col") for text in ("", "held", "least margin where it held")])
    rows = [head, *(_measured(what, found) for what, found in measures.items())]
    return tag("section", tag("h2", "Goal"), tag("table", tag("tbody", rows)))


def _measured(what: str, found: Sequence[Mapping[str, Any]]) -> Markup:
    held = [one["margin"] for one in found if one["margin"] >= 0]
    scale, unit = (1000, "mm") if found[0]["unit"] == "m" else (1, found[0]["unit"])
    least = f"{min(held) * scale:.3g} {unit}" if held else ""
    count = f"{len(held):,} of {len(found):,}"
    return tag("tr", tag("th", what, scope="row"), tag("td", count), tag("td", least))


def _workspace(
    good: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]], boxes: Mapping[str, Box]
) -> Markup | None:
    """Plots of where each object stood at the start; None if no layout is known."""
    panels = []
    for name in dict.fromkeys(name for trial in (*good, *failed) for name in trial["layout"]):
        stood, fell = (
            [_start(trial, name) for trial in trials if name in trial["layout"]] for trials in (good, failed)
        )
        box, title = boxes.get(name), f"{name}, start"
        grid = coverage(stood, *box, CELL_M) if box else None
        caption = f"{grid.cells_hit} of {grid.cells} cells with a success" if grid else "it starts on another thing"
        panels.append(captioned(title, workspace(Places(stood, (), fell, grid), box, "world", title), caption))
    if not panels:
        return None
    entries = [tag("span", tag("i"), "success")]
    if failed:
        entries.append(tag("span", tag("i", class_="failed"), "failure"))
    entries.append(tag("span", tag("i", class_="cell"), f"cell of {CELL_M * 100:g} cm with a success"))
    legend = tag("div", entries, class_="legend")
    return tag("section", tag("h2", "Workspace"), legend, tag("div", panels, class_="plans"))


def _start(trial: Mapping[str, Any], name: str) -> Point:
    x, y, *_ = trial["layout"][name]
    return x, y


def _failures(failed: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not failed:
        return None
    rows = [
        tag(
            "tr", tag("th", str(trial["trial"]), scope="row"), tag("td", outcome["cause"]), tag("td", outcome["detail"])
        )
        for trial in failed
        for outcome in (trial["outcome"],)
    ]
    return tag("section", tag("h2", "Failures"), tag("table", tag("tbody", rows)))
