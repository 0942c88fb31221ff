"""HTML page on the gap between recordings and their simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from yamsim_cli.core.markup import (
    Markup,
    captioned_jpeg,
    captioned_plot,
    html_page,
    html_section,
    html_table,
    html_tag,
    key_figures,
    percent,
    plot_legend,
)
from yamsim_cli.plots import Values, plot_curves

_UNKNOWN_VALUE_TEXT = "\N{EM DASH}"  # figures that the recordings do not determine
_MIN_ERROR_SPAN_MRAD = 0.2  # mrad, vertical range of an error plot


@dataclass(frozen=True)
class JointCurves:
    """A joint's positions over time.

    Attributes:
        times: (n,), s.
        commanded, measured, simulated: (n,), rad; NaN where not measured.
        worst_error_time: time of the worst error of all joints, s, if this joint has it.
    """

    name: str
    times: Values
    commanded: Values
    measured: Values
    simulated: Values
    worst_error_time: float | None


@dataclass(frozen=True)
class CaptionedJpeg:
    """A JPEG and its caption."""

    caption: str
    jpeg: bytes


def gap_page(
    report: Mapping[str, Any], joints: Sequence[JointCurves], pictures: Sequence[CaptionedJpeg], made: str
) -> str:
    """Return the HTML page on a gap.

    Args:
        report: from `gap.report.build_report`.
        joints: of the recording with the worst error.
        pictures: simulated arms over photos, the worst first.
        made: text of the footer.
    """
    recordings = report["recordings"]
    several = len(recordings) > 1
    title = f"{len(recordings)} recordings" if several else recordings[0]["name"]
    body = [
        html_tag("p", f"on rig {report['rig']}; errors are measured minus simulated values", class_="where"),
        _key_figures_section(report),
        _joints_section(report["joints"]),
        _hands_section(report["hands"]),
        _phases_section(report["phases"]),
        _joint_plots_section(joints, report["worst"]),
        _recordings_section(recordings) if several else None,
        _pictures_section(report.get("pictures"), pictures),
        _problems_section(report.get("problems", ())),
    ]
    return html_page(f"{title}: gap", "Gap to the simulation", title, body, made)


def _key_figures_section(report: Mapping[str, Any]) -> Markup:
    worst = report["worst"]
    hand = max(report["hands"], key=lambda hand: hand["rms_mm"])
    bounds = report.get("intervals", {}).get("rms_rad")
    interval = f" ({bounds[0] * 1000:.3g} to {bounds[1] * 1000:.3g})" if bounds else ""
    figures = [
        (f"{report['rms_rad'] * 1000:.3g} mrad", f"RMS of all joints{interval}"),
        (f"{hand['rms_mm']:.3g} mm", f"RMS of the {_row_name(hand, 'hand')}"),
    ]
    if delays := [joint["delay_s"] for joint in report["joints"] if joint["delay_s"] is not None]:
        figures.append((f"{np.median(delays) * 1000:.1f} ms", "delay relative to the simulation, median of the joints"))
    figures += [
        (f"{abs(worst['error_rad']) * 1000:.3g} mrad", f"largest error: {_row_name(worst, worst['joint'])}"),
        (f"{report['seconds']:.0f} s", "compared"),
    ]
    return key_figures(figures)


def _joints_section(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("joint", "RMS", "95 %", "largest", "delay", "sag", "overshoot", "delay after command", "simulated")
    cells = [
        [
            _row_name(row, row["name"]),
            *_format_errors(row),
            _format_delay_ms(row),
            _format_mrad(row, "sag_rad"),
            _format_mrad(row, "overshoot_rad"),
            _format_delay_ms(row["command_to_measured"]),
            _format_delay_ms(row["command_to_simulated"]),
        ]
        for row in rows
    ]
    note = (
        "Errors are in mrad. Delay, sag and overshoot are relative to the simulation: if the delay is positive, the "
        "recorded arm is later than the simulated arm. Sag is the mean error at rest. In brackets: 95 % intervals of "
        "the means over the recordings."
    )
    return html_section("By joint", html_tag("p", note, class_="note"), _scrollable_table(heads, cells))


def _hands_section(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("hand", "RMS", "95 %", "largest", "rotation, RMS", "rotation, largest", "delay", "fingers, RMS")
    cells = [
        [
            _row_name(row, "hand"),
            *(
                f"{_format_number(row[key])}{_format_interval(row, key, 1)} mm"
                for key in ("rms_mm", "p95_mm", "max_mm")
            ),
            *(f"{_format_number(row[key])}\N{DEGREE SIGN}" for key in ("rms_deg", "max_deg")),
            _format_delay_ms(row),
            _UNKNOWN_VALUE_TEXT if row["opening_rms_mm"] is None else f"{_format_number(row['opening_rms_mm'])} mm",
        ]
        for row in rows
    ]
    return html_section("By hand", _scrollable_table(heads, cells))


def _phases_section(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("phase of the joint", "share of samples", "RMS, mrad", "95 %", "largest")
    cells = [[row["name"], percent(row["share"], 0), *_format_errors(row)] for row in rows]
    return html_section("By phase of motion", _scrollable_table(heads, cells))


def _joint_plots_section(joints: Sequence[JointCurves], worst: Mapping[str, Any]) -> Markup:
    panels = []
    for joint in joints:
        lines = {"commanded": joint.commanded, "measured": joint.measured, "simulated": joint.simulated}
        error = (joint.measured - joint.simulated) * 1000
        title = f"{joint.name}: error"
        error_plot = plot_curves(
            title, joint.times, {"error-curve": error}, "mrad", joint.worst_error_time, _MIN_ERROR_SPAN_MRAD
        )
        panels += [
            captioned_plot(joint.name, plot_curves(joint.name, joint.times, lines, "rad", joint.worst_error_time), ""),
            captioned_plot(title, error_plot, f"Largest error {np.nanmax(np.abs(error)):.3g} mrad."),
        ]
    where = (
        f"The largest error is at {worst['time_s']:.3f} s, frame {worst['frame']} of {worst['recording']}: "
        f"{_row_name(worst, worst['joint'])} is {worst['error_rad'] * 1000:.3g} mrad from the simulated joint."
    )
    entries = [("commanded", "commanded"), (None, "measured"), ("simulated", "simulated")]
    return html_section(
        "Over time", html_tag("p", where), plot_legend(entries), html_tag("div", panels, class_="columns")
    )


def _recordings_section(rows: Sequence[Mapping[str, Any]]) -> Markup:
    heads = ("recording", "RMS, mrad", "95 %", "largest", "worst joint", "at", "frame", "compared")
    cells = [
        [
            row["name"],
            *_format_errors(row),
            _row_name(row["worst"], row["worst"]["joint"]),
            f"{row['worst']['time_s']:.2f} s",
            str(row["worst"]["frame"]),
            f"{row['seconds']:.1f} s",
        ]
        for row in sorted(rows, key=lambda row: -row["rms_rad"])
    ]
    return html_section("By recording", _scrollable_table(heads, cells))


def _pictures_section(figures: Mapping[str, Any] | None, pictures: Sequence[CaptionedJpeg]) -> Markup | None:
    if figures is None:
        return None
    sentences = [f"{figures['photos']} photos of camera {figures['camera']} were compared."]
    if without := figures["without_pose"]:
        sentences.append(f"{without} were left out, because the pose of their camera is not known.")
    for key, what, unit in (
        ("outline_px", "Distance of the arm's outline from the photo's edges", "px"),
        (
            "measured_outline_px",
            "The same distance for the arm at its measured joints, which does not include the gap",
            "px",
        ),
        ("iou", "Overlap (IoU) of the arm at its simulated and at its measured joints", ""),
    ):
        if (found := figures[key]) is not None:
            sentences.append(f"{what}: {found['mean']:.3g} {unit} on average, {found['worst']:.3g} at worst.")
    shown = [captioned_jpeg(picture.caption, picture.jpeg, 460) for picture in pictures]
    return html_section("In images", html_tag("p", " ".join(sentences)), html_tag("div", shown, class_="strips"))


def _problems_section(rows: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not rows:
        return None
    items = [html_tag("li", f"{row['recording']}: {row['text']}") for row in rows]
    return html_section("Problems of the recordings", html_tag("ul", items))


def _scrollable_table(headings: Sequence[str], cells: Sequence[Sequence[str]]) -> Markup:
    return html_tag("div", html_table(headings, cells), class_="scroll")


def _row_name(row: Mapping[str, Any], name: str) -> str:
    return f"{row['arm']} {name}" if row["arm"] else name


def _format_errors(row: Mapping[str, Any]) -> list[str]:
    return [_format_mrad(row, key) for key in ("rms_rad", "p95_rad", "max_rad")]


def _format_mrad(row: Mapping[str, Any], key: str) -> str:
    return (
        _UNKNOWN_VALUE_TEXT
        if row[key] is None
        else f"{_format_number(row[key] * 1000)}{_format_interval(row, key, 1000)}"
    )


def _format_delay_ms(row: Mapping[str, Any]) -> str:
    if row["delay_s"] is None:
        return _UNKNOWN_VALUE_TEXT
    return f"{_format_number(round(row['delay_s'] * 1000, 1))} ms{_format_interval(row, 'delay_s', 1000)}"


def _format_interval(row: Mapping[str, Any], key: str, scale: float) -> str:
    bounds = row.get("intervals", {}).get(key)
    return f" ({_format_number(bounds[0] * scale)} to {_format_number(bounds[1] * scale)})" if bounds else ""


def _format_number(value: float) -> str:
    return f"{round(value, 3) + 0.0:.3g}".replace("-", "\N{MINUS SIGN}")
