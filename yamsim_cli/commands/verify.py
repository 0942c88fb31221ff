from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.flags.selection_file import SelectionFile, selection_of
from yamsim_cli.flags.session_options import Json, Offline, session_opener
from yamsim_cli.terminal.console import print_report, progress_bar
from yamsim_cli.terminal.tables import NameValueTable

if TYPE_CHECKING:
    from rich.text import Text

# Check -> label in the report.
_METHOD_LABELS = {
    "seed": "made again from its seed",
    "actions": "simulated from its actions",
    "images": "rendered again",
}

# Largest difference that rounding alone explains: m, rad, or relative for numbers above 1. Another processor rounds the
# last bit differently, and contacts amplify the difference. On an emulated processor, most of 40 episodes differed by
# 1.5e-4, and the worst by 1.4e-3 (the tilt of a rolling banana).
_MAX_VERSION_DIFFERENCE = 0.005

_MAX_LISTED_DIFFERENCES = 10  # of differences, and of problems; --json has all


def verify(
    dataset: Annotated[Path, typer.Argument(help="The directory that `yamsim record` wrote.", show_default=False)],
    episodes: Annotated[
        str | None, typer.Option(metavar="LIST", help="Numbers of the episodes, such as 0,3,5-9.  [default: all]")
    ] = None,
    sample: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="N episodes, spread evenly over the dataset.")
    ] = None,
    selection: SelectionFile = None,
    workers: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    tolerance: Annotated[
        float,
        typer.Option(min=0.0, help="Largest difference of a number: m, rad, or relative where the number is above 1."),
    ] = 0.0,
    images: Annotated[
        bool, typer.Option("--images", help="Also render the images again, and compare the JPEG files.")
    ] = False,
    image_tolerance: Annotated[
        float, typer.Option(min=0.0, help="With --images: largest mean difference of an image's pixels, of 255.")
    ] = 0.0,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Reproduce episodes from their seeds and from their actions, and report the first value that differs.

    Exit code 4 if a value differs. Whole episodes are reproduced, also those that --selection trims.

    Example: yamsim verify dataset/ --sample 20
    """
    if episodes is not None and sample is not None:
        raise UsageError("--episodes and --sample exclude each other; give one")
    if image_tolerance and not images:
        raise UsageError(f"--image-tolerance {image_tolerance:g} needs --images")

    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.dataset.reader import read_recording_config, select_episode_directories

    where, applied = session_opener.find_locations(), selection_of(dataset, selection)
    chosen = select_episode_directories(dataset, episodes, sample, applied.kept if applied else None)
    if not chosen and applied:
        raise UsageError(f"--episodes {episodes}: {applied.path} keeps none of these; give others")
    session = Session(read_recording_config(dataset, where), where)
    if images:
        session_opener.choose_gl_backend(where, workers=True)
        session = session_opener.with_scene_meshes(session)
    else:
        session_opener.disable_gl()

    from yamsim_cli.datasets.verify import Tolerances
    from yamsim_cli.datasets.verify import verify as run

    limits = Tolerances(tolerance, image_tolerance if images else None)
    with progress_bar("verifying", "episodes") as advance:
        report = run(chosen, session, limits, workers, advance)
    report = {"path": str(dataset)} | report | {"selection": applied and applied.report()}
    print_report(report, lambda: NameValueTable(_result_rows(report)), json)
    if report["agree"] < report["episodes"]:
        raise DatasetError(_verdict_line(report))


def _result_rows(report: dict[str, Any]) -> Iterator[tuple[str | Text, str]]:
    from rich.text import Text

    yield "dataset", report["path"]
    yield "episodes that agree", f"{report['agree']} of {report['episodes']}"
    for check, label in _METHOD_LABELS.items():
        if found := report["checks"][check]:
            apart = "pixels differ by up to" if check == "images" else "largest difference"
            exact = " (bit for bit)" if not found["max_error"] and found["agree"] else ""
            figures = f"{found['agree']} of {found['episodes']}, {apart} {found['max_error']:.3g}{exact}"
            yield label, figures if found["episodes"] else "none"
            for reason in found["skipped"]:
                yield "", f"not made for some: {reason}"
    for change in report["versions_changed"]:
        yield f"{change['name']} changed", f"{change['recorded']} then, {change['now']} now"
    for divergence in report["divergences"][:_MAX_LISTED_DIFFERENCES]:
        yield Text("differs", style="red"), _difference_text(divergence)
    for problem in report["problems"][:_MAX_LISTED_DIFFERENCES]:
        yield Text("problem", style="red"), _problem_text(problem)
    yield "time", f"{report['seconds']:.1f} s, {report['seconds'] / report['episodes']:.2f} s an episode"


def _difference_text(divergence: dict[str, Any]) -> str:
    frame, time_s = divergence["frame"], divergence["time_s"]
    place = f"ep_{divergence['episode']:06d}"
    if frame is not None:
        place += f" frame {frame}" + (f" ({time_s:.3f} s)" if time_s is not None else "")
    stored, got = (f"{v:.9g}" if isinstance(v, float) else v for v in (divergence["stored"], divergence["got"]))
    apart = divergence["difference"]
    by = "" if apart is None else f", {apart:.3g} apart"
    return (
        f"{place}: {divergence['quantity']} is stored as {stored} "
        f"and is {got} if {_METHOD_LABELS[divergence['check']]}{by}"
    )


def _problem_text(problem: dict[str, Any]) -> str:
    place = f"ep_{problem['episode']:06d}/{problem['file']}: " if problem["file"] else ""
    return f"{place}{problem['problem']}"


def _verdict_line(report: dict[str, Any]) -> str:
    first = report["first_divergence"]
    text = _difference_text(first) if first else _problem_text(report["problems"][0])
    differing = report["episodes"] - report["agree"]
    more = f" (and {differing - 1} more episodes)" if differing > 1 else ""
    changes = ", ".join(f"{c['name']} {c['recorded']} (now {c['now']})" for c in report["versions_changed"])
    since = f"; recorded with {changes}" if changes else ""
    return f"{report['path']}: {text}{more}{since}{_tolerance_hint(report)}"


def _tolerance_hint(report: dict[str, Any]) -> str:
    """Advise a tolerance if rounding alone can explain the differences."""
    unequal = any(divergence["difference"] is None for divergence in report["divergences"])
    if unequal or report["problems"] or not report["tolerance"] < report["max_error"] <= _MAX_VERSION_DIFFERENCE:
        return ""
    flag = f"--tolerance {_MAX_VERSION_DIFFERENCE:g}"
    return (
        f"; if the dataset was recorded on another kind of processor, rounding can cause this difference: give {flag}"
    )
