from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import note_moved, progress_bar
from .tables import NameValueTable

if TYPE_CHECKING:
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.progress import Progress
    from yamsim_cli.trials import FilmedTrial, TrialVideoWriter


def trials_table(report: dict[str, Any]) -> NameValueTable:
    """Return a table of a batch of trials, the result of `run_batch`."""
    return NameValueTable([("trials", str(report["n"])), *_success_rows(report, report), *_batch_rows(report)])


def evaluation_table(report: dict[str, Any]) -> NameValueTable:
    """Return a table of a policy's `evaluation_report`."""
    return NameValueTable(
        [("policy", report["policy"]), *_success_rows(report, report["stats"]), *_evaluation_rows(report)]
    )


def open_films(path: Path, settings: RecordConfig, *, overwrite: bool) -> TrialVideoWriter:
    """Return a writer of trial videos. An unusable path raises an error now, before any trial runs."""
    from yamsim_cli.trials import TrialVideoWriter

    timing = settings.task.timing
    return TrialVideoWriter(path, timing.tick_seconds * timing.ticks_per_frame, overwrite=overwrite)


def film_with_progress(films: TrialVideoWriter, make: Callable[[Progress], list[FilmedTrial]]) -> list[dict[str, Any]]:
    """Make videos with a progress bar. Return the number and video path of each trial."""
    with progress_bar("filming", "trials") as advance:
        filmed = make(advance)
    note_moved(films.path, films.moved_aside)
    return [{"trial": film.trial, "path": str(film.path)} for film in filmed]


def _success_rows(report: dict[str, Any], counts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (label, text) rows of success rates and causes of failure, from `count_outcomes`."""
    yield "task", f"{report['task']} on {report['rig']}"
    low, high = counts["wilson95"]
    limit_m = counts["threshold_m"]
    yield (
        "success" if limit_m is None else f"success within {limit_m * 100:g} cm",
        f"{counts['n_success']} of {counts['n']} ({counts['success_rate']:.1%}; 95 % interval {low:.1%} to {high:.1%})",
    )
    for limit, rate in counts["rates"].items():
        yield f"within {float(limit) * 100:g} cm", f"{rate:.1%}"
    if spread := counts["dxy_m"]:
        yield "distance from the centre", _spread_text(spread, "mm")
    for cause, count in counts["causes"].items():
        yield f"failed: {cause}", str(count)
    if counts["recovered"]:
        yield "recovered", f"{counts['recovered']} of the successes tried a skill again"


def _batch_rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    if margins := report["margins"]:
        yield (
            "worst motion",
            f"{margins['velocity_share']:.0%} of a motor's speed, {margins['torque_share']:.0%} of a drive's torque, "
            f"{margins['joint_rad']:.2f} rad from a joint limit",
        )
    if margins and margins["slip_m"] is not None:
        yield (
            f"held by {report['grasp']}",
            f"slipped {margins['slip_m'] * 1000:.1f} mm and tilted {margins['object_tilt_rad']:.2f} rad at most",
        )
    for trial in report["trials"]:
        if not trial["outcome"]["success"]:
            yield f"trial {trial['trial']}", trial["outcome"]["detail"]
    yield from _film_rows(report)
    yield "time", f"{report['seconds']:.1f} s, {report['core_seconds_per_trial']:.2f} s of one core a trial"


def _evaluation_rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    stats = report["stats"]
    if "mean_bottles_in_bin" in stats:  # ABC's task, in reports of `abc_evaluation`
        most, last = stats["mean_most_bottles_in_bin"], stats["mean_bottles_in_bin"]
        yield "bottles in the bin", f"at most {most:.2f}, and {last:.2f} at the end (means of the trials)"
        yield "engine", report["settings"]["engine"]
    if spread := stats["policy_s"]:
        late = f"; {stats['slower_than_real_time']:.0%} longer than a control tick of {report['tick_s'] * 1000:g} ms"
        yield "an answer of the policy", _spread_text(spread, "ms") + late
    chunks = stats["chunks"]
    if chunks["actions"] > chunks["chunks"] or chunks["stale"] or chunks["waited_s"]:
        yield (
            "actions",
            f"{chunks['actions']} in {chunks['chunks']} chunks; {chunks['stale']} came too late, "
            f"and for {chunks['waited_s']:.2f} s no action was available",
        )
    for key, label in (("offset_m", "offset from the target"), ("offset_in_hand_m", "offset in the hand")):
        if found := stats.get(key):
            yield label, _offset_text(found)
    if len(stats["by_instance"]) > 1:
        for one in stats["by_instance"]:
            low, high = one["wilson95"]
            yield one["instance"], f"{one['n_success']} of {one['n']} ({low:.1%} to {high:.1%})"
    for pair in report.get("compared", []):
        yield (
            "compared",
            f"with {pair['policy']}: {pair['success_rate']:.1%}; both {pair['both']}, only {report['policy']} "
            f"{pair['only_first']}, only the other {pair['only_second']}, neither {pair['neither']} of {pair['n']}; "
            f"difference {pair['difference']:+.1%} ({pair['difference95'][0]:+.1%} to {pair['difference95'][1]:+.1%}), "
            f"p = {pair['p_value']:.3g} (McNemar, exact)",
        )
        for key, (one, other) in pair["settings_differ"].items():
            yield "compared", f"{key} differs: {one} here, {other} for {pair['policy']}"
    for trial in report["trials"]:
        if trial["error"]:
            yield f"trial {trial['trial']}: {trial['ended']}", trial["error"]
    yield from _film_rows(report)
    yield "time", f"{report['seconds']:.1f} s, {report['ticks_per_second']:.0f} control ticks a second"


def _spread_text(spread: dict[str, float], thousandths: str) -> str:
    return ", ".join(f"{name} {value * 1000:.1f} {thousandths}" for name, value in spread.items())


def _offset_text(offset: dict[str, Any]) -> str:
    """Return mean and standard deviation by axis, such as "mean x +1.0 mm (3.0), y -2.0 mm (4.0)"."""
    values = zip("xyz", offset["mean"], offset["deviation"], strict=False)
    return "mean " + ", ".join(f"{axis} {mean * 1000:+.1f} mm ({dev * 1000:.1f})" for axis, mean, dev in values)


def _film_rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    if films := report.get("videos"):
        paths = list(dict.fromkeys(film["path"] for film in films))
        yield "videos", f"{len(films)} trials, {paths[0]}" + (" and so on" if len(paths) > 1 else "")
