"""How far recordings lie from the simulation, as one HTML page: by joint, by hand, by phase, and where it is worst."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .axes import percent
from .curves import curves
from .markup import Markup, tag
from .page import captioned, document, figure

_NONE = "\N{EM DASH}"
# What an error's plot spans at least, mrad.
_LEAST_ERROR = 0.2

Values = NDArray[np.float64]


@dataclass(frozen=True)
class JointCurves:
    """What one joint was told, did, and does in the simulation, over time.

    Attributes:
        name: whose.
        times: (n,), s.
        told, measured, simulated: (n,), rad; NaN where nothing was measured.
        mark: the time of the worst error, if that was this joint's, s.
    """

    name: str
    times: Values
    told: Values
    measured: Values
    simulated: Values
    mark: float | None


@dataclass(frozen=True)
class Shown:
    """A picture of the page: a JPEG, and what is seen."""

    caption: str
    jpeg: bytes


def gap_page(report: Mapping[str, Any], joints: Sequence[JointCurves], pictures: Sequence[Shown], made: str) -> str:
    """The page as HTML.

    Args:
        report: of `gap.report.report_of`.
        joints: of the recording with the worst error.
        pictures: the simulated arms over photos of the recordings, the worst first.
        made: a line for the foot of the page: by what it was made, and when.
    """
    recordings, worst = report["recordings"], report["worst"]
    several = len(recordings) > 1
    title = f"{len(recordings)} recordings" if several else recordings[0]["name"]
    body = [
        tag("p", "Gap to the simulation", class_="kicker"),
        tag("h1", title),
        tag("p", f"on rig {report['rig']}; errors are what was measured less what was simulated", class_="where"),
        _figures(report),
        _joints(report["joints"]),
        _hands(report["hands"]),
        _phases(report["phases"]),
        _plots(joints, worst),
        _recordings(recordings) if several else None,
        _pictures(report.get("pictures"), pictures),
        _problems(report.get("problems", ())),
    ]
    return document(f"{title}: gap", body, made)


def _figures(report: Mapping[str, Any]) -> Markup:
    worst = report["worst"]
    hands = max(report["hands"], key=lambda hand: hand["rms_mm"])
    cells = [
        figure(f"{report['rms_rad'] * 1000:.3g} mrad", _with_interval("RMS of all joints", report, "rms_rad", 1000)),
        figure(f"{hands['rms_mm']:.3g} mm", f"RMS of the {_called(hands, 'hand')}"),
        figure(f"{abs(worst['error_rad']) * 1000:.3g} mrad", f"worst: {_called(worst, worst['joint'])}"),
        figure(f"{report['seconds']:.0f} s", "compared"),
    ]
    delays = [joint["delay_s"] for joint in report["joints"] if joint["delay_s"] is not None]
    if delays:
        cells.insert(2, figure(f"{np.median(delays) * 1000:.1f} ms", "later than simulated, the joints' median"))
    return tag("div", cells, class_="figures")


def _with_interval(text: str, row: Mapping[str, Any], key: str, scale: float) -> str:
    bounds = row.get("intervals", {}).get(key)
    return f"{text} ({bounds[0] * scale:.3g} to {bounds[1] * scale:.3g})" if bounds else text


def _joints(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("joint", "RMS", "95 %", "largest", "delay", "sag", "overshoot", "delay after command", "simulated")
    cells = [
        [
            _called(row, row["name"]),
            _mrad(row, "rms_rad"),
            _mrad(row, "p95_rad"),
            _mrad(row, "max_rad"),
            _ms(row),
            _mrad(row, "sag_rad"),
            _mrad(row, "overshoot_rad"),
            _ms(row["command_to_measured"]),
            _ms(row["command_to_simulated"]),
        ]
        for row in rows
    ]
    note = tag(
        "p",
        "mrad and ms. Delay, sag and overshoot are those beyond the simulation's: a positive delay is one that the "
        "recording has and the simulation lacks. Sag is the mean error at rest. In brackets: 95 % intervals of means "
        "over the recordings.",
        class_="note",
    )
    return tag("section", tag("h2", "By joint"), note, _table(heads, cells))


def _hands(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("hand", "RMS", "95 %", "largest", "turned, RMS", "turned, largest", "delay", "fingers, RMS")
    cells = [
        [
            _called(row, "hand"),
            *(f"{_number(row[key])}{_bracket(row, key, 1)} mm" for key in ("rms_mm", "p95_mm", "max_mm")),
            *(f"{_number(row[key])}\N{DEGREE SIGN}" for key in ("rms_deg", "max_deg")),
            _ms(row),
            _NONE if row["opening_rms_mm"] is None else f"{_number(row['opening_rms_mm'])} mm",
        ]
        for row in rows
    ]
    return tag("section", tag("h2", "By hand"), _table(heads, cells))


def _phases(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("the joint is", "share of samples", "RMS, mrad", "95 %", "largest")
    cells = [
        [row["name"], percent(row["share"], 0), *(_mrad(row, key) for key in ("rms_rad", "p95_rad", "max_rad"))]
        for row in rows
    ]
    return tag("section", tag("h2", "By phase of motion"), _table(heads, cells))


def _plots(joints: Sequence[JointCurves], worst: Mapping[str, Any]) -> Markup:
    entries = [
        tag("span", tag("i", class_="told"), "told"),
        tag("span", tag("i"), "measured"),
        tag("span", tag("i", class_="simulated"), "simulated"),
    ]
    panels = []
    for joint in joints:
        lines = {"told": joint.told, "measured": joint.measured, "simulated": joint.simulated}
        error = {"error-curve": (joint.measured - joint.simulated) * 1000}
        said = f"Largest error {np.nanmax(np.abs(error['error-curve'])):.3g} mrad."
        panels += [
            captioned(joint.name, curves(joint.name, joint.times, lines, "rad", joint.mark), ""),
            captioned(
                f"{joint.name}: error",
                curves(f"{joint.name}: error", joint.times, error, "mrad", joint.mark, _LEAST_ERROR),
                said,
            ),
        ]
    where = (
        f"The worst error is at {worst['time_s']:.3f} s, frame {worst['frame']} of {worst['recording']}: "
        f"{_called(worst, worst['joint'])} is {worst['error_rad'] * 1000:.3g} mrad from its simulation."
    )
    legend = tag("div", entries, class_="legend")
    return tag("section", tag("h2", "Over time"), tag("p", where), legend, tag("div", panels, class_="columns"))


def _recordings(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("recording", "RMS, mrad", "95 %", "largest", "worst joint", "at", "frame", "compared")
    ordered = sorted(rows, key=lambda row: -row["rms_rad"])
    cells = [
        [
            row["name"],
            *(_mrad(row, key) for key in ("rms_rad", "p95_rad", "max_rad")),
            _called(row["worst"], row["worst"]["joint"]),
            f"{row['worst']['time_s']:.2f} s",
            str(row["worst"]["frame"]),
            f"{row['seconds']:.1f} s",
        ]
        for row in ordered
    ]
    return tag("section", tag("h2", "By recording"), _table(heads, cells))


def _pictures(figures: Mapping[str, Any] | None, pictures: Sequence[Shown]) -> Markup | None:
    if figures is None:
        return None
    said = [f"{figures['photos']} photos of camera {figures['camera']} were compared."]
    for key, what, unit in (
        ("outline_px", "outline to the photo's edges", "px"),
        ("iou", "overlap with the arm where it was measured", ""),
    ):
        if (found := figures[key]) is not None:
            said.append(f"{what.capitalize()}: {found['mean']:.3g} {unit} on average, {found['worst']:.3g} at worst.")
    shown = [
        tag(
            "figure",
            tag(
                "img",
                src=f"data:image/jpeg;base64,{base64.b64encode(picture.jpeg).decode()}",
                alt=picture.caption,
                width=460,
            ),
            tag("figcaption", picture.caption),
        )
        for picture in pictures
    ]
    return tag("section", tag("h2", "In pictures"), tag("p", " ".join(said)), tag("div", shown, class_="strips"))


def _problems(rows: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not rows:
        return None
    items = [tag("li", f"{row['recording']}: {row['text']}") for row in rows]
    return tag("section", tag("h2", "What is wrong with the recordings"), tag("ul", items))


def _called(row: Mapping[str, Any], name: str) -> str:
    return f"{row['arm']} {name}" if row["arm"] else name


def _mrad(row: Mapping[str, Any], key: str) -> str:
    return _NONE if row[key] is None else f"{_number(row[key] * 1000)}{_bracket(row, key, 1000)}"


def _ms(row: Mapping[str, Any]) -> str:
    if row["delay_s"] is None:
        return _NONE
    return f"{_number(round(row['delay_s'] * 1000, 1))} ms{_bracket(row, 'delay_s', 1000)}"


def _bracket(row: Mapping[str, Any], key: str, scale: float) -> str:
    bounds = row.get("intervals", {}).get(key)
    return f" ({_number(bounds[0] * scale)} to {_number(bounds[1] * scale)})" if bounds else ""


def _number(value: float) -> str:
    return f"{round(value, 3) + 0.0:.3g}".replace("-", "\N{MINUS SIGN}")


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    head = tag("thead", tag("tr", [tag("th", text, scope="col") for text in heads]))
    lines = [tag("tr", tag("th", row[0], scope="row"), [tag("td", cell) for cell in row[1:]]) for row in rows]
    return tag("div", tag("table", head, tag("tbody", lines)), class_="scroll")
