"""`yamsim export`: a dataset in the formats of others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import note, print_json, print_line, progress_bar
from .session import Json, locations, skip_gl

if TYPE_CHECKING:
    from yamsim_cli.core.jobs.exports.source import Exported, Source
    from yamsim_cli.core.resources import Locations

app = typer.Typer(help="Write a dataset in the formats of others.", no_args_is_help=True)

Dataset = Annotated[Path, typer.Argument(help="The directory that `yamsim record` wrote.", show_default=False)]
Out = Annotated[Path, typer.Argument(help="Directory to make.", show_default=False)]
Episodes = Annotated[str | None, typer.Option(metavar="LIST", help="Which episodes, such as 0,3,5-9.  [default: all]")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Move what is in the way aside.")]


@app.callback()
def _export() -> None:
    """Write a dataset in the formats of others; what is at OUT is whole or not there."""


@app.command()
def raiden(
    dataset: Dataset, out: Out, episodes: Episodes = None, overwrite: Overwrite = False, json: Json = False
) -> None:
    """The converted layout of the real stack (TRI's raiden), images and depth byte for byte as they are.

    Example: yamsim export raiden dataset/ real_layout/
    """
    source, where = _source(dataset, episodes)

    from yamsim_cli.core.jobs.exports.raiden import export_raiden

    with progress_bar("exporting", "episodes") as advance:
        done = export_raiden(source, out, where, lambda n, total: advance(n, total, ""), overwrite=overwrite)
    _show(done, json)


@app.command()
def lerobot(
    dataset: Dataset, out: Out, episodes: Episodes = None, overwrite: Overwrite = False, json: Json = False
) -> None:
    """LeRobotDataset v3.0: Parquet, and H.264 with exact times.

    Example: yamsim export lerobot dataset/ lerobot_dataset/
    """
    source, _ = _source(dataset, episodes)

    from yamsim_cli.core.jobs.exports.lerobot import export_lerobot

    with progress_bar("exporting", "episodes") as advance:
        done = export_lerobot(source, out, lambda n, total: advance(n, total, ""), overwrite=overwrite)
    _show(done, json)


def _source(dataset: Path, episodes: str | None) -> tuple[Source, Locations]:
    """The chosen episodes; nothing is drawn for an export."""
    skip_gl()

    from yamsim_cli.core.jobs.exports.source import open_source

    where = locations()
    return open_source(dataset, episodes, where), where


def _show(done: Exported, json: bool) -> None:
    if done.moved_aside:
        note(f"What was at {done.path} is now at {done.moved_aside}.")
    if json:
        moved = str(done.moved_aside) if done.moved_aside else None
        print_json({"path": str(done.path), "episodes": done.episodes, "frames": done.frames, "moved_aside": moved})
    else:
        print_line(f"{done.episodes} episodes, {done.frames} frames in {done.path}")
