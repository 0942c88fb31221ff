"""`yamsim import`: recordings of real arms become a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from yamsim_cli.core.errors import UsageError, counted
from yamsim_cli.flags.session import Json, opener
from yamsim_cli.terminal.console import note, print_json, print_line, progress_bar


def import_recording(
    source: Annotated[
        list[Path],
        typer.Argument(
            help="A .csv, .mcap or robot_data.npz; a folder with rgb/ and lowdim/, or of such; a LeRobot dataset.",
            show_default=False,
        ),
    ],
    rig: Annotated[str, typer.Option(help="Whose arms they are: a name from configs/rigs/ or a YAML file.")] = "single",
    out: Annotated[Path, typer.Option(help="The dataset to write.")] = Path("real"),
    kind: Annotated[
        Literal["csv", "lowdim", "raiden_raw", "lerobot", "mcap"] | None,
        typer.Option("--format", help="Of the recordings.  [default: found out]"),
    ] = None,
    mapping: Annotated[
        str | None,
        typer.Option(
            help="How their columns are called: a name from configs/recordings/ or a YAML.  [default: found out]"
        ),
    ] = None,
    gripper: Annotated[
        Literal["metres", "share", "closed_share"] | None,
        typer.Option(help="Of one finger; 0 closed .. 1 open; 0 open .. 1 closed.  [default: the format's]"),
    ] = None,
    mirror_gripper: Annotated[
        Literal["measured", "commanded", "both"] | None,
        typer.Option(help="Which openings are upside down: 0 open, and the widest closed.", show_default=False),
    ] = None,
    degrees: Annotated[bool, typer.Option("--degrees", help="Joints are in degrees.")] = False,
    swap_arms: Annotated[
        bool, typer.Option("--swap-arms", help="What was measured of the left arm is the right one's.")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Keep the episodes that are there.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Move what is at --out aside.")] = False,
    json: Json = False,
) -> None:
    """Bring recordings of real arms into a dataset, marked `source: real`. What is missing stays missing.

    Example: yamsim import log.csv --rig single --out real
    """
    if resume and overwrite:
        raise UsageError("--resume continues a dataset, and --overwrite moves it aside: give one of them")
    where = opener.locations()
    opener.skip_gl()
    settings = opener.rig(rig, where)

    from yamsim_cli.core.dataset.writing.opening import OpenMode
    from yamsim_cli.core.import_recording.importing import Corrections, ImportRequest, import_recordings

    mode = OpenMode.RESUME if resume else OpenMode.OVERWRITE if overwrite else OpenMode.NEW
    said = Corrections(degrees, swap_arms, gripper, mirror_gripper)
    request = ImportRequest(source, settings, kind, mapping, said, out, mode)
    with progress_bar("import", "episodes") as advance:
        report = import_recordings(request, where, advance)
    if json:
        print_json(report.plain())
        return
    if report.moved_aside:
        note(f"What was at {out} is now at {report.moved_aside}.")
    for episode, problems in report.problems.items():
        for problem in problems:
            note(f"{episode}: {problem}")
    kept = f", {report.kept} were there" if report.kept else ""
    print_line(
        f"{report.path}: {counted(report.episodes, 'episode')}, {counted(report.frames, 'frame')}{kept}, source: real"
    )
