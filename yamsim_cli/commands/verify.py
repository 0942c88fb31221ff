"""`yamsim verify`: whether a dataset can be made again from what it says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.flags.session import Json, Offline, opener
from yamsim_cli.terminal.console import print_json, print_table, progress_bar
from yamsim_cli.terminal.tables import facts

from .divergence import WAYS, sentence, trouble, verdict

if TYPE_CHECKING:
    from rich.text import Text


def verify(
    dataset: Annotated[Path, typer.Argument(help="The directory that `yamsim record` wrote.", show_default=False)],
    episodes: Annotated[
        str | None, typer.Option(metavar="LIST", help="Which episodes, such as 0,3,5-9.  [default: all]")
    ] = None,
    sample: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="N episodes, spread evenly over the dataset.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="How much a number may differ: m, rad, or relative where it is above 1.")
    ] = 0.0,
    images: Annotated[bool, typer.Option("--images", help="Render again too, and compare the JPEG files.")] = False,
    image_tolerance: Annotated[
        float, typer.Option(min=0.0, help="With --images: how far pixels may differ in an image's mean, of 255.")
    ] = 0.0,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Make episodes again, from their seeds and from their actions, and name the first value that differs.

    Exit code 4 if anything does.

    Example: yamsim verify dataset/ --sample 20
    """
    if episodes is not None and sample is not None:
        raise UsageError("--episodes and --sample exclude each other; give one")
    if image_tolerance and not images:
        raise UsageError(f"--image-tolerance {image_tolerance:g} needs --images")

    from yamsim_cli.core.dataset.reader import dataset_config, select_episodes
    from yamsim_cli.core.session import Session

    where = opener.locations()
    chosen = select_episodes(dataset, episodes, sample)
    session = Session(dataset_config(dataset, where), where)
    if images:
        opener.use_gl(where, workers=True)
        session = opener.with_meshes(session)
    else:
        opener.skip_gl()

    from yamsim_cli.core.verify import Tolerances
    from yamsim_cli.core.verify import verify as run

    limits = Tolerances(tolerance, image_tolerance if images else None)
    with progress_bar("verifying", "episodes") as advance:
        report = run(chosen, session, limits, workers, advance)
    report = {"path": str(dataset)} | report
    if json:
        print_json(report)
    else:
        print_table(facts(_rows(report)))
    if report["agree"] < report["episodes"]:
        raise DatasetError(verdict(report))


def _rows(report: dict[str, Any]) -> Iterator[tuple[str | Text, str]]:
    from rich.text import Text

    yield "dataset", report["path"]
    yield "episodes that agree", f"{report['agree']} of {report['episodes']}"
    for check, label in WAYS.items():
        if found := report["checks"][check]:
            apart = "pixels differ by up to" if check == "images" else "largest difference"
            exact = " (bit for bit)" if not found["max_error"] and found["agree"] else ""
            figures = f"{found['agree']} of {found['episodes']}, {apart} {found['max_error']:.3g}{exact}"
            yield label, figures if found["episodes"] else "none"
            for reason in found["skipped"]:
                yield "", f"not made for some: {reason}"
    for change in report["versions_changed"]:
        yield f"{change['name']} changed", f"{change['recorded']} then, {change['now']} now"
    for divergence in report["divergences"][:10]:
        yield Text("differs", style="red"), sentence(divergence)
    for problem in report["problems"][:10]:
        yield Text("problem", style="red"), trouble(problem)
    yield "time", f"{report['seconds']:.1f} s, {report['seconds'] / report['episodes']:.2f} s an episode"
