"""Report on recordings' sim-to-real gap: means with 95 % intervals, a limit, and the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.markup import page_footer, write_page
from yamsim_cli.core.statistics import student_t_quantile_95
from yamsim_cli.real.gap.command_simulation import forward_fill

from .gap_figures import ErrorStats, HandGap, JointGap, MotionGap, TrackingFigures, WorstError
from .gap_page import CaptionedJpeg, JointCurves, gap_page
from .joint_curves import PHASES


def mean_interval95(values: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % interval of normal values' mean; None for fewer than two."""
    n = len(values)
    if n < 2:
        return None
    mean, half = float(np.mean(values)), student_t_quantile_95(n - 1) * float(np.std(values, ddof=1)) / math.sqrt(n)
    return mean - half, mean + half


def build_report(gaps: Sequence[MotionGap], rig: str) -> dict[str, Any]:
    """Return the gap as JSON data: means over recordings of the same arms, the worst error, and each recording.

    For largest errors, the maximum replaces the mean; figures that no recording has are null. `intervals`
    has 95 % intervals of means over two or more recordings. Errors are measured minus simulated, rad and mm.
    """
    worst = max(gaps, key=lambda gap: abs(gap.worst.error))
    return {
        "rig": rig,
        "seconds": sum(gap.seconds for gap in gaps),
        **_mean_figures(gaps, lambda gap: _error_data(gap.error)),
        "joints": [_joint_data([gap.joints[k] for gap in gaps]) for k in range(len(gaps[0].joints))],
        "hands": [_hand_data([gap.hands[k] for gap in gaps]) for k in range(len(gaps[0].hands))],
        "phases": _phase_data([gap.phases for gap in gaps]),
        "worst": {"recording": worst.name, **_worst_error_data(worst.worst)},
        "recordings": [
            {
                "name": gap.name,
                "seconds": gap.seconds,
                "samples": int(gap.is_compared.sum()),
                **_error_data(gap.error),
                "joints": [_joint_data([joint]) for joint in gap.joints],
                "hands": [_hand_data([hand]) for hand in gap.hands],
                "phases": _phase_data([gap.phases]),
                "worst": _worst_error_data(gap.worst),
            }
            for gap in gaps
        ],
    }


def require_gap_below(report: Mapping[str, Any], max_mrad: float | None) -> None:
    """Check each joint's RMS error in a report from `build_report`; None is no limit.

    Raises:
        SimulationError: a joint's error is larger.
    """
    if max_mrad is None:
        return
    above = [joint for joint in report["joints"] if joint["rms_rad"] * 1000 > max_mrad]
    if above:
        worst = max(above, key=lambda joint: joint["rms_rad"])
        more = f" (and {len(above) - 1} more)" if len(above) > 1 else ""
        raise SimulationError(
            f"the error of {joint_display_name(worst)} is {worst['rms_rad'] * 1000:.3g} mrad RMS{more}, more than "
            f"--fail-above {max_mrad:g}"
        )


def joint_display_name(row: Mapping[str, Any]) -> str:
    """Return the name of a joint or a hand, such as `left joint2`."""
    return " ".join(part for part in (row["arm"], row.get("name", "hand")) if part)


def _mean_figures(rows: Sequence[Any], figures: Callable[[Any], Mapping[str, float | None]]) -> dict[str, Any]:
    """Return means of the rows' `hand_error_data` with 95 % `intervals`; of names with `max`, maxima."""
    values = [figures(row) for row in rows]
    known = {key: [value for one in values if (value := one[key]) is not None] for key in values[0]}
    largest = {key for key in known if "max" in key.split("_")}
    never_negative = {key for key in known if {"rms", "p95"} & set(key.split("_"))}
    means = {
        key: float(np.max(values) if key in largest else np.mean(values)) if values else None
        for key, values in known.items()
    }
    intervals = {
        key: [max(0.0, bounds[0]) if key in never_negative else bounds[0], bounds[1]]
        for key, values in known.items()
        if key not in largest and (bounds := mean_interval95(values))
    }
    return {**means, **({"intervals": intervals} if intervals else {})}


def _joint_data(rows: Sequence[JointGap]) -> dict[str, Any]:
    return {
        "arm": rows[0].arm,
        "name": rows[0].name,
        **_mean_figures(rows, lambda row: {**_error_data(row.error), **_tracking_data(row.measured_vs_simulated)}),
        "command_to_measured": _mean_figures(rows, lambda row: _tracking_data(row.measured)),
        "command_to_simulated": _mean_figures(rows, lambda row: _tracking_data(row.simulated)),
        "phases": _phase_data([row.phases for row in rows]),
    }


def _error_data(size: ErrorStats) -> dict[str, float | None]:
    return {"rms_rad": size.rms, "p95_rad": size.p95, "max_rad": size.max}


def _tracking_data(found: TrackingFigures) -> dict[str, float | None]:
    return {"delay_s": found.delay, "sag_rad": found.sag, "overshoot_rad": found.overshoot}


def _hand_data(rows: Sequence[HandGap]) -> dict[str, Any]:
    def hand_error_data(row: HandGap) -> dict[str, float | None]:
        found: dict[str, float | None] = {}
        for key in ("rms", "p95", "max"):
            found[f"{key}_mm"] = getattr(row.position, key) * 1000
            found[f"{key}_deg"] = math.degrees(getattr(row.rotation, key))
            found[f"opening_{key}_mm"] = getattr(row.opening, key) * 1000 if row.opening else None
        return {**found, "delay_s": row.delay}

    return {"arm": rows[0].arm, **_mean_figures(rows, hand_error_data)}


def _phase_data(rows: Sequence[Mapping[str, ErrorStats]]) -> list[dict[str, Any]]:
    samples = sum(size.samples for row in rows for size in row.values())
    found = []
    for phase in map(str, PHASES):
        sizes = [row[phase] for row in rows if phase in row]
        if sizes:
            share = sum(size.samples for size in sizes) / samples
            found.append({"name": phase, "share": share, **_mean_figures(sizes, _error_data)})
    return found


def _worst_error_data(worst: WorstError) -> dict[str, Any]:
    return {
        "frame": worst.frame,
        "time_s": worst.time,
        "arm": worst.arm,
        "joint": worst.joint,
        "error_rad": worst.error,
    }


def write_gap_page(
    report: Mapping[str, Any], gaps: Sequence[MotionGap], pictures: Sequence[CaptionedJpeg], path: Path
) -> None:
    """Write the HTML page on a gap to `path`, replacing a file, with curves of the recording with the worst error.

    Args:
        report: result of `build_report` from `gaps`.
        pictures: the worst first.

    Raises:
        ResourceError: the file cannot be written.
    """
    worst = max(gaps, key=lambda gap: abs(gap.worst.error))
    write_page(gap_page(report, _joint_curves(worst), pictures, page_footer()), path)


def _joint_curves(gap: MotionGap) -> list[JointCurves]:
    found = []
    compared = np.flatnonzero(gap.is_compared)
    shown = slice(int(compared[0]), int(compared[-1]) + 1)
    names = iter(gap.joints)
    for real, simulated in zip(gap.motion.arms, gap.simulated.arms, strict=True):
        assert real.commands is not None, "the simulation followed them"
        commands = forward_fill(real.commands, real.joints)
        for k in range(real.joints.shape[1]):
            joint = next(names)
            marked = (joint.arm, joint.name) == (gap.worst.arm, gap.worst.joint)
            found.append(
                JointCurves(
                    f"{joint.arm} {joint.name}".strip(),
                    gap.motion.times[shown],
                    commands[shown, k],
                    np.where(gap.is_compared, real.joints[:, k], np.nan)[shown],
                    np.where(gap.is_compared, simulated.joints[:, k], np.nan)[shown],
                    gap.worst.time if marked else None,
                )
            )
    return found
