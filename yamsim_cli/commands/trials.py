"""A batch's figures for a person."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from .tables import facts

if TYPE_CHECKING:
    from rich.table import Table


def trials_table(report: dict[str, Any]) -> Table:
    """What `jobs.batch.run_batch` reports, as a table."""
    return facts(_rows(report))


def _rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "trials", str(report["n"])
    low, high = report["wilson95"]
    yield (
        f"success within {report['threshold_m'] * 100:g} cm",
        f"{report['n_success']} ({report['success_rate']:.1%}; 95 % interval {low:.1%} to {high:.1%})",
    )
    for limit, rate in report["rates"].items():
        yield f"within {float(limit) * 100:g} cm", f"{rate:.1%}"
    if spread := report["dxy_m"]:
        yield "distance from the centre", ", ".join(f"{name} {value * 1000:.1f} mm" for name, value in spread.items())
    if margins := report["margins"]:
        yield (
            "worst motion",
            f"{margins['velocity_share']:.0%} of a motor's speed, {margins['torque_share']:.0%} of a drive's torque, "
            f"{margins['joint_rad']:.2f} rad from a stop",
        )
        yield (
            f"held by {report['grasp']}",
            f"slipped {margins['slip_m'] * 1000:.1f} mm, tilted {margins['object_tilt_rad']:.2f} rad at most",
        )
    for cause, count in report["causes"].items():
        yield f"failed: {cause}", str(count)
    for trial in report["trials"]:
        if not trial["outcome"]["success"]:
            yield f"trial {trial['trial']}", trial["outcome"]["detail"]
    if films := report.get("videos"):
        paths = list(dict.fromkeys(film["path"] for film in films))
        yield "videos", f"{len(films)} trials, {paths[0]}" + (" and so on" if len(paths) > 1 else "")
    yield "time", f"{report['seconds']:.1f} s, {report['core_seconds_per_trial']:.2f} s of one core a trial"
