"""A dataset's report as one HTML page without other files, for a browser, a wiki or a printer."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..dataset.summary import Survey
from . import findings, plots
from .axes import percent
from .markup import Child, Markup, style, tag
from .places import workspace_section

# The browser loads nothing but the page itself: no script, font or picture from elsewhere, whatever the dataset holds.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

_STYLE = Path(__file__).with_name("report.css")

_MOST_CAUSES = 12
_WILSON = "Wilson's 95\N{NO-BREAK SPACE}% intervals"


@dataclass(frozen=True)
class Strip:
    """JPEGs of an episode's first, middle and last frame, as far as they can be shown."""

    episode: str
    caption: str
    pictures: Sequence[bytes]


def page(survey: Survey, summary: Mapping[str, Any], strips: Sequence[Strip], made: str) -> str:
    """The page as HTML.

    Args:
        summary: the survey's figures by `dataset.summary.summarize`.
        made: a line for the foot of the page: by what it was made, and when.
    """
    name = survey.path.absolute().name or str(survey.path)
    sections = [
        _figures(summary),
        findings.problems_section(summary),
        _success(summary),
        workspace_section(survey, summary),
        _contact_sheet(strips),
        _details(summary),
    ]
    body = [
        tag("p", "Dataset report", class_="kicker"),
        tag("h1", name),
        tag("p", str(survey.path.absolute()), class_="where"),
        findings.verdict(summary),
        sections,
    ]
    return document(f"{name}: dataset report", body, made)


def document(title: str, body: Iterable[Child], made: str) -> str:
    """A whole page around `body`, with the style sheet in its head and `made` at its foot."""
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="referrer", content="no-referrer"),
        tag("title", title),
        style(_STYLE.read_text(encoding="utf-8")),
    ]
    main = tag("main", body, tag("footer", made))
    return "<!doctype html>\n" + tag("html", tag("head", head), tag("body", main), lang="en") + "\n"


def figure(value: str, label: str) -> Markup:
    """One of the large figures at the top of a page."""
    return tag("div", tag("b", value), tag("span", label))


def _figures(summary: Mapping[str, Any]) -> Markup:
    cells = [
        figure(f"{summary['episodes']:,}", "episodes"),
        figure(f"{summary['frames']:,}", "frames"),
        figure(_duration(summary["seconds"]), "of motion"),
        figure(_size(summary["bytes"]), "on the disk"),
    ]
    attempts = summary["attempts"]
    if attempts["n"]:
        low, high = attempts["wilson95"]
        cells.append(
            figure(
                percent(attempts["success_rate"]),
                f"of {attempts['n']:,} attempts ({percent(low, 0)} to {percent(high, 0)})",
            )
        )
    if summary["dxy_m"]:
        spread = summary["dxy_m"]
        cells.append(
            figure(
                f"{spread['median'] * 1000:.1f} mm",
                f"median distance (95\N{NO-BREAK SPACE}%: {spread['p95'] * 1000:.1f} mm)",
            )
        )
    return tag("div", cells, class_="figures")


def _success(summary: Mapping[str, Any]) -> Markup | None:
    figures = []
    rows = []
    attempts = summary["attempts"]
    for limit, rate in summary["success_rate"].items():
        if rate is not None:
            rows.append((f"episodes, {float(limit) * 100:g} cm", rate, summary["wilson95"][limit]))
    if attempts["n"]:
        for limit, rate in attempts["rates"].items():
            rows.append((f"attempts, {float(limit) * 100:g} cm", rate, attempts["rates_wilson95"][limit]))
    if rows:
        whose = "Of the episodes, and of all attempts made for them" if attempts["n"] else "Of the episodes"
        caption = f"{whose}; lines are {_WILSON}."
        figures.append(captioned("Success by threshold", plots.rates(rows), caption))
    limits = [float(limit) for limit in summary["success_rate"]]
    for key, title, shown in (
        ("dxy_m", "Distance from the target's centre", limits),
        ("dz_m", "Height over the target", []),
    ):
        if spread := summary[key]:
            found = spread["histogram"]
            caption = ", ".join(f"{word} {spread[k] * 1000:.1f} mm" for k, word in _SPREAD.items())
            figures.append(
                captioned(
                    title, plots.distances(found["edges"], found["counts"], shown, title), caption.capitalize() + "."
                )
            )
    if causes := attempts["causes"]:
        kept = dict(list(causes.items())[:_MOST_CAUSES])
        caption = f"{sum(causes.values()):,} of {attempts['n']:,} attempts failed."
        figures.append(captioned("Failures by cause", plots.bars(kept), caption))
    if not figures:
        return None
    return tag("section", tag("h2", "Success"), tag("div", figures, class_="columns"))


_SPREAD = {"median": "median", "p95": "95 %", "max": "largest"}


def captioned(title: str, picture: Markup, caption: str) -> Markup:
    """A plot with its title and caption."""
    return tag("figure", tag("h3", title), picture, tag("figcaption", caption))


def _contact_sheet(strips: Sequence[Strip]) -> Markup | None:
    if not strips:
        return None
    shown = []
    for strip in strips:
        images = [
            tag(
                "img",
                src=f"data:image/jpeg;base64,{base64.b64encode(data).decode()}",
                alt=f"{strip.episode}, picture {k + 1}",
            )
            for k, data in enumerate(strip.pictures)
        ]
        caption = tag("figcaption", tag("code", strip.episode), f"  {strip.caption}")
        shown.append(tag("figure", tag("div", images, class_="strip"), caption))
    note = tag(
        "p", "First, middle and last frame; the episodes that ended farthest from the target come first.", class_="note"
    )
    return tag("section", tag("h2", "Pictures"), note, tag("div", shown, class_="strips"))


def _details(summary: Mapping[str, Any]) -> Markup | None:
    rows: list[tuple[str, str]] = [
        ("cameras", ", ".join(f"{name} {w}x{h}" for name, (w, h) in summary["cameras"].items())),
        ("tasks", ", ".join(summary["tasks"])),
        ("grasp", ", ".join(summary["grasps"])),
        ("frames an episode", _range(summary["frames_per_episode"], str)),
        ("size of an episode", _range(summary["bytes_per_episode"], _size)),
    ]
    rows += [
        ("versions", ", ".join(f"{name} {number}" for name, number in versions.items()))
        for versions in summary["versions"]
    ]
    cells = [tag("tr", tag("th", name, scope="row"), tag("td", value)) for name, value in rows if value]
    if not cells:
        return None
    return tag("section", tag("h2", "How it was made"), tag("table", tag("tbody", cells)))


def _range(spread: Mapping[str, Any] | None, shown: Any) -> str:
    if not spread:
        return ""
    if spread["min"] == spread["max"]:
        return str(shown(spread["min"]))
    return f"{shown(spread['min'])} to {shown(spread['max'])}, median {shown(spread['median'])}"


def _duration(seconds: float) -> str:
    if seconds >= 7200:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.1f} min" if seconds >= 120 else f"{seconds:.0f} s"


def _size(size: float) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size / 1e3:.1f} kB"
