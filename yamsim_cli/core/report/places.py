"""The report's plots of the workspace: each object at the start, and at the end if it moved."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..dataset.checks.facts import EpisodeFacts
from ..dataset.summary import Survey, within, workspace_coverage
from .markup import Markup, tag
from .plan import Places, Point, workspace

# An object gets a panel for its end only if it moved farther than this in some episode, m.
_STILL_M = 0.02

_MOST_OBJECTS = 4


def workspace_section(survey: Survey, summary: Mapping[str, Any]) -> Markup | None:
    """Plots of where objects lay, coloured by success at the smallest threshold; None if no places are known."""
    names = list(dict.fromkeys(name for episode in survey.episodes for name in episode.starts))[:_MOST_OBJECTS]
    threshold = min((float(limit) for limit in summary["success_rate"]), default=survey.context.threshold)
    panels = []
    for name in names:
        panels.append(_panel(survey, name, threshold, last=False))
        if _moved(survey.episodes, name):
            panels.append(_panel(survey, name, threshold, last=True))
    shown = [panel for panel in panels if panel]
    if not shown:
        return None
    legend = _legend(survey, threshold)
    return tag("section", tag("h2", "Workspace"), legend, tag("div", shown, class_="plans"))


def _panel(survey: Survey, name: str, threshold: float, *, last: bool) -> Markup | None:
    good: list[Point] = []
    bad: list[Point] = []
    for episode in survey.episodes:
        point = (episode.ends if last else episode.starts).get(name)
        if point:
            (good if within(episode, threshold, survey) or not episode.outcome else bad).append(point)
    failed = [] if last else _failed_starts(survey, name)
    if not (good or bad or failed):
        return None
    grid = workspace_coverage(survey, good + bad)
    box = survey.context.sampling
    title = f"{name}, {'end' if last else 'start'}"
    frame = "world" if survey.context.recorded else "the robot's base"
    picture = workspace(Places(good, bad, failed, grid), (box.x, box.y) if box else None, frame, title)
    caption = (
        f"{grid.cells_hit} of {grid.cells} cells hit, {grid.outside} outside the box"
        if grid
        else "sampling box unknown"
    )
    return tag("figure", tag("h3", title), picture, tag("figcaption", caption))


def _failed_starts(survey: Survey, name: str) -> list[Point]:
    layouts = [attempt.layout for attempt in survey.attempts if not attempt.outcome.success]
    return [(layout[name][0], layout[name][1]) for layout in layouts if name in layout]


def _moved(episodes: Sequence[EpisodeFacts], name: str) -> bool:
    pairs = [(e.starts[name], e.ends[name]) for e in episodes if name in e.starts and name in e.ends]
    return any(math.dist(start, end) > _STILL_M for start, end in pairs)


def _legend(survey: Survey, threshold: float) -> Markup:
    entries = [tag("span", tag("i"), f"episode within {threshold * 100:g} cm")]
    scored = [episode for episode in survey.episodes if episode.outcome]
    if any(not within(episode, threshold, survey) for episode in scored):
        entries.append(tag("span", tag("i", class_="bad"), f"episode beyond {threshold * 100:g} cm"))
    if any(not attempt.outcome.success for attempt in survey.attempts):
        entries.append(tag("span", tag("i", class_="failed"), "failed attempt"))
    if survey.context.sampling:
        entries.append(tag("span", tag("i", class_="cell"), "cell of 5 cm that was hit"))
    return tag("div", entries, class_="legend")
