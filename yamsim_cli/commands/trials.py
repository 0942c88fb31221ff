"""A batch's figures for a person."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def trials_table(report: dict[str, Any]) -> Table:
    """What `jobs.batch.run_batch` reports, as a table."""
    from rich.table import Table

    table = Table("trials", str(report["n"]), title="pick and place", title_justify="left")
    low, high = report["wilson95"]
    table.add_row(
        f"success within {report['threshold_m'] * 100:g} cm",
        f"{report['n_success']} ({report['success_rate']:.1%}; 95 % interval {low:.1%} to {high:.1%})",
    )
    for limit, rate in report["rates"].items():
        table.add_row(f"within {float(limit) * 100:g} cm", f"{rate:.1%}")
    if spread := report["dxy_m"]:
        figures = ", ".join(f"{name} {value * 1000:.1f} mm" for name, value in spread.items())
        table.add_row("distance from the centre", figures)
    if margins := report["margins"]:
        table.add_row(
            "worst motion",
            f"{margins['velocity_share']:.0%} of a motor's speed, {margins['torque_share']:.0%} of a drive's torque, "
            f"{margins['joint_rad']:.2f} rad from a stop",
        )
        table.add_row(
            f"held by {report['grasp']}",
            f"slipped {margins['slip_m'] * 1000:.1f} mm and tilted {margins['object_tilt_rad']:.2f} rad at most",
        )
    for cause, count in report["causes"].items():
        table.add_row(f"failed: {cause}", str(count))
    for trial in report["trials"]:
        if not trial["outcome"]["success"]:
            table.add_row(f"trial {trial['trial']}", trial["outcome"]["detail"])
    if films := report.get("videos"):
        paths = list(dict.fromkeys(film["path"] for film in films))
        table.add_row("videos", f"{len(films)} trials, {paths[0]}" + (" and so on" if len(paths) > 1 else ""))
    table.add_row("time", f"{report['seconds']:.1f} s, {report['core_seconds_per_trial']:.2f} s of one core a trial")
    return table
