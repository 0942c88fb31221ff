"""The gap of several recordings: means with 95 % intervals, as plain data, and whether it is small enough."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import SimulationError
from .figures import Following, Gap, HandGap, JointGap, Size, Worst
from .phases import PHASES

# Two-sided 95 % of Student's t distribution, by degrees of freedom from 1 on.
# Source: NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.2.
_T95: tuple[float, ...] = (
    12.706,
    4.303,
    3.182,
    2.776,
    2.571,
    2.447,
    2.365,
    2.306,
    2.262,
    2.228,
    2.201,
    2.179,
    2.160,
    2.145,
    2.131,
    2.120,
)
_T95 += (2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042)
_Z95 = 1.959963984540054


def student95(values: Sequence[float]) -> tuple[float, float] | None:
    """The 95 % interval of the mean of values that are taken to be normal; None of fewer than two."""
    n = len(values)
    if n < 2:
        return None
    # Beyond the table, the next term of the quantile's series in 1 / n.
    t = _T95[n - 2] if n - 2 < len(_T95) else _Z95 * (1 + (_Z95**2 + 1) / (4 * (n - 1)))
    mean, half = float(np.mean(values)), t * float(np.std(values, ddof=1)) / math.sqrt(n)
    return mean - half, mean + half


def report_of(gaps: Sequence[Gap], rig: str) -> dict[str, Any]:
    """The gap of recordings as plain data, for JSON: means over the recordings, the worst of all, and each of them.

    A figure is a mean over the recordings that tell it, null where none does, and of the largest errors the largest.
    `intervals` has its 95 % interval where two or more tell it. Errors are what was measured less what was simulated,
    in rad and mm.

    Args:
        gaps: of recordings of the same arms, at least one.
    """
    worst = max(gaps, key=lambda gap: abs(gap.worst.error))
    return {
        "rig": rig,
        "seconds": sum(gap.seconds for gap in gaps),
        **_means(gaps, lambda gap: {"rms_rad": gap.error.rms, "p95_rad": gap.error.p95, "max_rad": gap.error.max}),
        "joints": [_joints([gap.joints[k] for gap in gaps]) for k in range(len(gaps[0].joints))],
        "hands": [_hands([gap.hands[k] for gap in gaps]) for k in range(len(gaps[0].hands))],
        "phases": _phases([gap.phases for gap in gaps]),
        "worst": {"recording": worst.name, **_worst(worst.worst)},
        "recordings": [
            {
                "name": gap.name,
                "seconds": gap.seconds,
                "samples": int(gap.counted.sum()),
                "rms_rad": gap.error.rms,
                "p95_rad": gap.error.p95,
                "max_rad": gap.error.max,
                "joints": [_joints([joint]) for joint in gap.joints],
                "hands": [_hands([hand]) for hand in gap.hands],
                "phases": _phases([gap.phases]),
                "worst": _worst(gap.worst),
            }
            for gap in gaps
        ],
    }


def require_small(report: Mapping[str, Any], most_mrad: float | None) -> None:
    """Make sure that no joint's gap is larger than somebody allows.

    Args:
        report: of `report_of`.
        most_mrad: the largest root mean square error that any joint may have, mrad; None for any.

    Raises:
        SimulationError: a joint's is larger.
    """
    if most_mrad is None:
        return
    above = [joint for joint in report["joints"] if joint["rms_rad"] * 1000 > most_mrad]
    if above:
        worst = max(above, key=lambda joint: joint["rms_rad"])
        more = f" (and {len(above) - 1} more)" if len(above) > 1 else ""
        raise SimulationError(
            f"{spoken(worst)} is off by {worst['rms_rad'] * 1000:.3g} mrad RMS{more}: --fail-above asks for at most "
            f"{most_mrad:g}"
        )


def spoken(row: Mapping[str, Any]) -> str:
    """A joint's or a hand's name as people say it: `left joint2`, `joint2`."""
    return " ".join(part for part in (row["arm"], row.get("name", "hand")) if part)


def _means(rows: Sequence[Any], told: Callable[[Any], Mapping[str, float | None]]) -> dict[str, Any]:
    """Figure -> its mean over the rows that tell it, and under `intervals` figure -> the mean's 95 % interval.

    Of the largest errors it is the largest.
    """
    said = [told(row) for row in rows]
    known = {key: [value for one in said if (value := one[key]) is not None] for key in said[0]}
    largest = {key for key in known if "max" in key.split("_")}
    means = {
        key: float(np.max(values) if key in largest else np.mean(values)) if values else None
        for key, values in known.items()
    }
    intervals = {
        key: [max(0.0, bounds[0]) if _is_size(key) else bounds[0], bounds[1]]
        for key, values in known.items()
        if key not in largest and (bounds := student95(values))
    }
    return {**means, **({"intervals": intervals} if intervals else {})}


def _is_size(key: str) -> bool:
    """Whether a figure is a size of errors, which is never below 0."""
    return not {"rms", "p95"}.isdisjoint(key.split("_"))


def _joints(rows: Sequence[JointGap]) -> dict[str, Any]:
    return {
        "arm": rows[0].arm,
        "name": rows[0].name,
        **_means(rows, lambda row: {**_size(row.error), **_following(row.beyond)}),
        "command_to_measured": _means(rows, lambda row: _following(row.measured)),
        "command_to_simulated": _means(rows, lambda row: _following(row.simulated)),
        "phases": _phases([row.phases for row in rows]),
    }


def _size(size: Size) -> dict[str, float | None]:
    return {"rms_rad": size.rms, "p95_rad": size.p95, "max_rad": size.max}


def _following(found: Following) -> dict[str, float | None]:
    return {"delay_s": found.delay, "sag_rad": found.sag, "overshoot_rad": found.overshoot}


def _hands(rows: Sequence[HandGap]) -> dict[str, Any]:
    def told(row: HandGap) -> dict[str, float | None]:
        figures: dict[str, float | None] = {}
        for key in ("rms", "p95", "max"):
            figures[f"{key}_mm"] = getattr(row.position, key) * 1000
            figures[f"{key}_deg"] = math.degrees(getattr(row.turn, key))
            figures[f"opening_{key}_mm"] = getattr(row.opening, key) * 1000 if row.opening else None
        return {**figures, "delay_s": row.delay}

    return {"arm": rows[0].arm, **_means(rows, told)}


def _phases(rows: Sequence[Mapping[str, Size]]) -> list[dict[str, Any]]:
    """For each phase that occurs: the mean errors over the recordings in which it does, and its share of samples."""
    samples = sum(size.samples for row in rows for size in row.values())
    found = []
    for phase in map(str, PHASES):
        sizes = [row[phase] for row in rows if phase in row]
        if sizes:
            share = sum(size.samples for size in sizes) / samples
            found.append({"name": phase, "share": share, **_means(sizes, _size)})
    return found


def _worst(worst: Worst) -> dict[str, Any]:
    return {
        "frame": worst.frame,
        "time_s": worst.time,
        "arm": worst.arm,
        "joint": worst.joint,
        "error_rad": worst.error,
    }
