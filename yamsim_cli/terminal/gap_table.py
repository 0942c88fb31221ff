from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.constrain import Constrain

from yamsim_cli.core.dataset.checks.problem import printable_line
from yamsim_cli.real.gap.report import joint_display_name

from .tables import ItemTable, NameValueTable

_WIDTH = 80  # terminal columns
_MAX_RECORDINGS = 10  # those with the largest errors; --json has all


def gap_tables(report: Mapping[str, Any]) -> RenderableType:
    """Return tables of measured minus simulated motion: total, by joint, by phase of motion, and by recording."""
    parts: list[RenderableType] = [_overview_table(report), _joint_table(report), _phase_table(report)]
    if len(report["recordings"]) > 1:
        parts.append(_recording_table(report))
    return Constrain(Group(*parts), _WIDTH)


def _overview_table(report: Mapping[str, Any]) -> NameValueTable:
    recordings, worst = report["recordings"], report["worst"]
    called = recordings[0]["name"] if len(recordings) == 1 else str(len(recordings))
    rows = [
        ("recordings" if len(recordings) > 1 else "recording", f"{printable_line(called)}, {report['seconds']:.1f} s"),
        ("rig", report["rig"]),
        ("joints", f"{_mrad(report, 'rms_rad')} mrad RMS, 95 % {_mrad(report, 'p95_rad')}{_interval_text(report)}"),
    ]
    for hand in report["hands"]:
        largest = f"at most {hand['max_mm']:.3g} mm and {hand['max_deg']:.2g} degrees"
        rows.append((joint_display_name(hand), f"{hand['rms_mm']:.3g} mm RMS, {largest}"))
    joint = f"{joint_display_name({'arm': worst['arm'], 'name': worst['joint']})}: {worst['error_rad'] * 1000:.3g} mrad"
    frame = f"frame {worst['frame']} of {printable_line(worst['recording'])}"
    rows.append(("worst", f"{joint} at {worst['time_s']:.2f} s, {frame}"))
    if pictures := report.get("pictures"):
        rows.append(("photos", _photo_text(pictures)))
    return NameValueTable(rows)


def _photo_text(pictures: Mapping[str, Any]) -> str:
    parts = [f"{pictures['photos']} of camera {pictures['camera']}"]
    if outline := pictures["outline_px"]:
        parts.append(f"outline {outline['mean']:.2g} px from the photos' edges, {outline['worst']:.2g} at worst")
    if overlap := pictures["iou"]:
        parts.append(f"overlap {overlap['mean']:.3f}, {overlap['worst']:.3f} at worst")
    return "; ".join(parts)


def _interval_text(row: Mapping[str, Any]) -> str:
    bounds = row.get("intervals", {}).get("rms_rad")
    return f"; mean within {bounds[0] * 1000:.3g} to {bounds[1] * 1000:.3g}" if bounds else ""


def _joint_table(report: Mapping[str, Any]) -> ItemTable:
    headings = ("joint", "RMS mrad", "95 %", "max", "delay ms", "sag mrad", "overshoot mrad")
    table = ItemTable(headings, "Measured minus simulated", whole=True)
    for joint in report["joints"]:
        delay = "" if joint["delay_s"] is None else f"{round(joint['delay_s'] * 1000, 1) + 0.0:.1f}"
        table.add_row(
            joint_display_name(joint),
            *_error_cells(joint),
            delay,
            _mrad(joint, "sag_rad"),
            _mrad(joint, "overshoot_rad"),
        )
    return table


def _phase_table(report: Mapping[str, Any]) -> ItemTable:
    table = ItemTable(("phase", "share", "RMS mrad", "95 %", "max"), "By phase of motion")
    for phase in report["phases"]:
        table.add_row(phase["name"], f"{phase['share']:.0%}", *_error_cells(phase))
    return table


def _recording_table(report: Mapping[str, Any]) -> ItemTable:
    ordered = sorted(report["recordings"], key=lambda row: -row["rms_rad"])
    table = ItemTable(("recording", "RMS mrad", "max", "worst joint", "at s"), "By recording, the largest first")
    for row in ordered[:_MAX_RECORDINGS]:
        worst = row["worst"]
        table.add_row(
            printable_line(row["name"]),
            _mrad(row, "rms_rad"),
            _mrad(row, "max_rad"),
            joint_display_name({"arm": worst["arm"], "name": worst["joint"]}),
            f"{worst['time_s']:.2f}",
        )
    return table


def _error_cells(row: Mapping[str, Any]) -> list[str]:
    return [_mrad(row, key) for key in ("rms_rad", "p95_rad", "max_rad")]


def _mrad(row: Mapping[str, Any], key: str) -> str:
    return "" if row[key] is None else f"{round(row[key] * 1000, 3) + 0.0:.3g}"
