"""What `yamsim eval` shows on a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from .tables import facts

if TYPE_CHECKING:
    from rich.table import Table


def evaluation_table(report: dict[str, Any]) -> Table:
    """A report of `core.jobs.evaluate.summary` as a table."""
    return facts(_rows(report))


def _rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    stats = report["stats"]
    low, high = stats["wilson95"]
    yield "policy", report["policy"]
    yield (
        f"success within {stats['threshold_m'] * 100:g} cm",
        f"{stats['n_success']} of {stats['n']} ({stats['success_rate']:.1%}; 95 % interval {low:.1%} to {high:.1%})",
    )
    for limit, rate in stats["rates"].items():
        yield f"within {float(limit) * 100:g} cm", f"{rate:.1%}"
    for cause, count in stats["causes"].items():
        yield f"failed: {cause}", str(count)
    if spread := stats["policy_s"]:
        figures = ", ".join(f"{name} {value * 1000:.1f} ms" for name, value in spread.items())
        late = f"; {stats['slower_than_real_time']:.0%} longer than a control tick of {report['tick_s'] * 1000:g} ms"
        yield "an answer of the policy", figures + late
    for trial in report["trials"]:
        if trial["error"]:
            yield f"trial {trial['trial']}: {trial['ended']}", trial["error"]
    if films := report.get("videos"):
        yield "videos", f"{len(films)} trials, such as {films[0]['path']}"
    yield "time", f"{report['seconds']:.1f} s"
