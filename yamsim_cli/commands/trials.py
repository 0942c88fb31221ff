"""Figures of a batch's or an evaluation's trials, for a person."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def trials_table(report: dict[str, Any]) -> Table:
    """What `jobs.batch.run_batch` reports, as a table."""
    table = _table("trials", str(report["n"]), report, report)
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
    for trial in report["trials"]:
        if not trial["outcome"]["success"]:
            table.add_row(f"trial {trial['trial']}", trial["outcome"]["detail"])
    _add_films(table, report)
    table.add_row("time", f"{report['seconds']:.1f} s, {report['core_seconds_per_trial']:.2f} s of one core a trial")
    return table


def evaluation_table(report: dict[str, Any]) -> Table:
    """What `jobs.evaluate.summary` reports, as a table."""
    stats = report["stats"]
    table = _table("policy", report["policy"], report, stats)
    if spread := stats["policy_s"]:
        late = f"; {stats['slower_than_real_time']:.0%} longer than a control tick of {report['tick_s'] * 1000:g} ms"
        table.add_row("an answer of the policy", _figures(spread, "ms") + late)
    for trial in report["trials"]:
        if trial["error"]:
            table.add_row(f"trial {trial['trial']}: {trial['ended']}", trial["error"])
    _add_films(table, report)
    table.add_row("time", f"{report['seconds']:.1f} s")
    return table


def _table(name: str, value: str, report: dict[str, Any], counts: dict[str, Any]) -> Table:
    """A table with what `jobs.tally.tally` counts."""
    from rich.table import Table

    table = Table(name, value, title=f"{report['task']} on {report['rig']}", title_justify="left")
    low, high = counts["wilson95"]
    table.add_row(
        f"success within {counts['threshold_m'] * 100:g} cm",
        f"{counts['n_success']} of {counts['n']} ({counts['success_rate']:.1%}; 95 % interval {low:.1%} to {high:.1%})",
    )
    for limit, rate in counts["rates"].items():
        table.add_row(f"within {float(limit) * 100:g} cm", f"{rate:.1%}")
    if spread := counts["dxy_m"]:
        table.add_row("distance from the centre", _figures(spread, "mm"))
    for cause, count in counts["causes"].items():
        table.add_row(f"failed: {cause}", str(count))
    return table


def _figures(spread: dict[str, float], thousandths: str) -> str:
    return ", ".join(f"{name} {value * 1000:.1f} {thousandths}" for name, value in spread.items())


def _add_films(table: Table, report: dict[str, Any]) -> None:
    if films := report.get("videos"):
        paths = list(dict.fromkeys(film["path"] for film in films))
        table.add_row("videos", f"{len(films)} trials, {paths[0]}" + (" and so on" if len(paths) > 1 else ""))
