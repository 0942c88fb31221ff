from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .. import plots
from ..core.errors import file_size
from ..core.markup import (
    HtmlChild,
    Markup,
    captioned_plot,
    grid_section,
    html_page,
    html_section,
    html_tag,
    jpeg_image,
    key_figures,
    percent,
    plot_legend,
    table_rows,
    verdict_sentence,
)
from ..plots import ObjectPlaces, Point, plot_workspace
from .check_summary import CheckResults, is_within_threshold, workspace_coverage
from .checks.episode_facts import EpisodeFacts

_MAX_CAUSES = 12  # the most frequent ones
_MAX_EXAMPLES = 5  # per problem code; --json lists all
_MAX_OBJECTS = 4  # with a plot of their positions
_MIN_PLOTTED_MOTION = 0.02  # m; objects that never move more have no plot of end positions
_INTERVAL_CAPTION = "Wilson's 95\N{NO-BREAK SPACE}% intervals"
_SPREAD_LABELS = {"median": "median", "p95": "95 %", "max": "largest"}


@dataclass(frozen=True)
class FrameStrip:
    """JPEG files of the first, middle and last frame of an episode, without unreadable ones."""

    episode: str
    caption: str
    pictures: Sequence[bytes]


def dataset_page(results: CheckResults, summary: Mapping[str, Any], strips: Sequence[FrameStrip], made: str) -> str:
    """Return the report page on a checked dataset as HTML.

    Args:
        made: text at the foot of the page.
    """
    path = results.path.absolute()
    name = path.name or str(results.path)
    body = [
        html_tag("p", str(path), class_="where"),
        _verdict_banner(summary),
        _headline_figures(summary),
        _problem_table(summary["problems"]),
        _success_section(summary),
        _workspace_section(results, summary),
        _contact_sheet(strips),
        _details_section(summary),
    ]
    return html_page(f"{name}: dataset report", "Dataset report", name, body, made)


def problem_counts(summary: Mapping[str, Any]) -> tuple[str, str]:
    """Return the numbers of errors and warnings, such as ``"1 error"`` and ``"1,200 warnings"``."""
    errors, warnings = summary["errors"], summary["warnings"]
    return f"{errors:,} error{'' if errors == 1 else 's'}", f"{warnings:,} warning{'' if warnings == 1 else 's'}"


def group_by_code(problems: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[Mapping[str, Any]]]]:
    """Return problems grouped by code, errors first."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for problem in problems:
        groups.setdefault(problem["code"], []).append(problem)
    return sorted(groups.items(), key=lambda group: group[1][0]["severity"])


def _verdict_banner(summary: Mapping[str, Any]) -> Markup:
    errors, warnings = problem_counts(summary)
    if summary["errors"]:
        return verdict_sentence(
            f"{errors} and {warnings}: correct the errors before you train on the dataset.", "error"
        )
    if not summary["episodes"]:
        return verdict_sentence("The dataset has no episodes yet.", "warning")
    if summary["warnings"]:
        return verdict_sentence(f"Complete, with {warnings}: check the problems below.", "warning")
    return verdict_sentence("Complete: every file was opened and is valid.", "fine")


def _headline_figures(summary: Mapping[str, Any]) -> Markup:
    figures = [
        (f"{summary['episodes']:,}", "episodes"),
        (f"{summary['frames']:,}", "frames"),
        (_duration(summary["seconds"]), "of motion"),
        (file_size(summary["bytes"]), "on the disk"),
    ]
    attempts = summary["attempts"]
    if attempts["n"]:
        low, high = attempts["wilson95"]
        label = f"of {attempts['n']:,} attempts ({percent(low, 0)} to {percent(high, 0)})"
        figures.append((percent(attempts["success_rate"]), label))
    if spread := summary["dxy_m"]:
        label = f"median distance (95\N{NO-BREAK SPACE}%: {spread['p95'] * 1000:.1f} mm)"
        figures.append((f"{spread['median'] * 1000:.1f} mm", label))
    return key_figures(figures)


def _problem_table(problems: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not problems:
        return None
    headings = (("problem", None), ("found", "number"), ("what and where", None), ("what to do", None))
    head = html_tag("tr", [html_tag("th", text, scope="col", class_=kind) for text, kind in headings])
    body = [_code_row(code, group) for code, group in group_by_code(problems)]
    return html_section(
        "Problems",
        html_tag("div", html_tag("table", html_tag("thead", head), html_tag("tbody", body)), class_="scroll"),
    )


def _code_row(code: str, problems: Sequence[Mapping[str, Any]]) -> Markup:
    examples = [html_tag("li", _problem_example(problem)) for problem in problems[:_MAX_EXAMPLES]]
    if len(problems) > _MAX_EXAMPLES:
        examples.append(html_tag("li", f"and {len(problems) - _MAX_EXAMPLES:,} more"))
    first = problems[0]
    # Advice has commands in backquotes.
    advice = [html_tag("code", part) if k % 2 else part for k, part in enumerate(first["advice"].split("`"))]
    return html_tag(
        "tr",
        html_tag("td", html_tag("code", code, class_=first["severity"]), class_="code"),
        html_tag("td", f"{len(problems):,}", class_="number"),
        html_tag("td", first["title"], html_tag("ul", examples)),
        html_tag("td", advice, class_="advice"),
    )


def _problem_example(problem: Mapping[str, Any]) -> list[HtmlChild]:
    place = "/".join(part for part in (problem["episode"], problem["file"]) if part)
    valid = f"; valid: {problem['valid']}" if problem["valid"] else ""
    more = f" (in {problem['count']} frames)" if problem["count"] > 1 else ""
    value = f"{problem['value']}{valid}{more}"
    return [html_tag("code", place) if place else None, ": " if place and value else None, value]


def _success_section(summary: Mapping[str, Any]) -> Markup | None:
    attempts = summary["attempts"]
    figures = []
    rate_rows = [
        (f"{label}, {float(limit) * 100:g} cm", rate, intervals[limit])
        for label, found, intervals in (
            ("episodes", summary["success_rate"], summary["wilson95"]),
            *([("attempts", attempts["rates"], attempts["rates_wilson95"])] if attempts["n"] else []),
        )
        for limit, rate in found.items()
        if rate is not None
    ]
    if rate_rows:
        whose = "Success rates of episodes and of all attempts" if attempts["n"] else "Success rates of episodes"
        figures.append(
            captioned_plot(
                "Success by threshold", plots.plot_rates(rate_rows), f"{whose}; lines are {_INTERVAL_CAPTION}."
            )
        )
    limits = [float(limit) for limit in summary["success_rate"]]
    for key, title, marked in (
        ("dxy_m", "Distance from the target's centre", limits),
        ("dz_m", "Height over the target", []),
    ):
        if spread := summary[key]:
            bins = spread["histogram"]
            caption = ", ".join(f"{word} {spread[k] * 1000:.1f} mm" for k, word in _SPREAD_LABELS.items())
            picture = plots.plot_distance_histogram(bins["edges"], bins["counts"], marked, title)
            figures.append(captioned_plot(title, picture, caption.capitalize() + "."))
    if causes := attempts["causes"]:
        caption = f"{sum(causes.values()):,} of {attempts['n']:,} attempts failed."
        bars = plots.plot_failures(dict(list(causes.items())[:_MAX_CAUSES]))
        figures.append(captioned_plot("Failures by cause", bars, caption))
    return grid_section("Success", figures, "columns")


def _workspace_section(results: CheckResults, summary: Mapping[str, Any]) -> Markup | None:
    names = list(dict.fromkeys(name for episode in results.episodes for name in episode.start_positions))[:_MAX_OBJECTS]
    threshold = min((float(limit) for limit in summary["success_rate"]), default=results.context.threshold)
    found = [
        _workspace_panel(results, name, threshold, last=last)
        for name in names
        for last in (False, True)
        if not last or _has_moved(results.episodes, name)
    ]
    panels = [panel for panel in found if panel]
    return grid_section("Workspace", panels, "plans", _workspace_legend(results, threshold) if panels else None)


def _workspace_panel(results: CheckResults, name: str, threshold: float, *, last: bool) -> Markup | None:
    good: list[Point] = []
    bad: list[Point] = []
    for episode in results.episodes:
        point = (episode.end_positions if last else episode.start_positions).get(name)
        if point:
            (good if is_within_threshold(episode, threshold, results) or not episode.outcome else bad).append(point)
    failed = [] if last else _failed_starts(results, name)
    if not (good or bad or failed):
        return None
    grid = workspace_coverage(results, good + bad)
    box = results.context.sampling
    title = f"{name}, {'end' if last else 'start'}"
    frame = "world" if results.context.recorded else "the robot's base"
    picture = plot_workspace(ObjectPlaces(good, bad, failed, grid), (box.x, box.y) if box else None, frame, title)
    known = f"{grid.hit_cell_count} of {grid.cell_count} cells used, {grid.outside} outside the box" if grid else ""
    return captioned_plot(title, picture, known or "sampling box unknown")


def _failed_starts(results: CheckResults, name: str) -> list[Point]:
    layouts = [attempt.layout for attempt in results.attempts if not attempt.outcome.success]
    return [(layout[name][0], layout[name][1]) for layout in layouts if name in layout]


def _has_moved(episodes: Sequence[EpisodeFacts], name: str) -> bool:
    pairs = [
        (e.start_positions[name], e.end_positions[name])
        for e in episodes
        if name in e.start_positions and name in e.end_positions
    ]
    return any(math.dist(start, end) > _MIN_PLOTTED_MOTION for start, end in pairs)


def _workspace_legend(results: CheckResults, threshold: float) -> Markup:
    entries: list[tuple[str | None, str]] = [(None, f"episode within {threshold * 100:g} cm")]
    if any(episode.outcome and not is_within_threshold(episode, threshold, results) for episode in results.episodes):
        entries.append(("bad", f"episode beyond {threshold * 100:g} cm"))
    if any(not attempt.outcome.success for attempt in results.attempts):
        entries.append(("failed", "failed attempt"))
    if results.context.sampling:
        entries.append(("cell", "cell of 5 cm with an episode"))
    return plot_legend(entries)


def _contact_sheet(strips: Sequence[FrameStrip]) -> Markup | None:
    shown = []
    for strip in strips:
        images = [jpeg_image(data, f"{strip.episode}, picture {k + 1}") for k, data in enumerate(strip.pictures)]
        caption = html_tag("figcaption", html_tag("code", strip.episode), f"  {strip.caption}")
        shown.append(html_tag("figure", html_tag("div", images, class_="strip"), caption))
    order = "First, middle and last frame of episodes, with the largest final distance from the target first."
    return grid_section("Pictures", shown, "strips", html_tag("p", order, class_="note"))


def _details_section(summary: Mapping[str, Any]) -> Markup | None:
    known = [
        ("cameras", ", ".join(f"{name} {w}x{h}" for name, (w, h) in summary["cameras"].items())),
        ("tasks", ", ".join(summary["tasks"])),
        ("grasp", ", ".join(summary["grasps"])),
        ("frames per episode", _range_text(summary["frames_per_episode"], str)),
        ("size per episode", _range_text(summary["bytes_per_episode"], file_size)),
        *(
            ("versions", ", ".join(f"{name} {number}" for name, number in versions.items()))
            for versions in summary["versions"]
        ),
    ]
    cells = table_rows((name, value) for name, value in known if value)
    return html_section("Settings and versions", html_tag("table", html_tag("tbody", cells))) if cells else None


def _range_text(spread: Mapping[str, Any] | None, shown: Callable[[Any], str]) -> str:
    if not spread:
        return ""
    if spread["min"] == spread["max"]:
        return shown(spread["min"])
    return f"{shown(spread['min'])} to {shown(spread['max'])}, median {shown(spread['median'])}"


def _duration(seconds: float) -> str:
    if seconds >= 7200:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.1f} min" if seconds >= 120 else f"{seconds:.0f} s"
