from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from yamsim_cli.core.errors import count_noun
from yamsim_cli.flags.output_files import RenameExisting, open_mode
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import note_moved, print_json, print_line, print_note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.real.import_recording.importing import KnownCamera


def import_recording(
    source: Annotated[
        list[Path],
        typer.Argument(
            help="A .csv, .mcap or robot_data.npz; a folder with rgb/ and lowdim/, or of such; a LeRobot dataset; "
            "episodes of the maker's or of ABC's, or folders of such.",
            show_default=False,
        ),
    ],
    rig: Annotated[
        str, typer.Option(help="Rig of the recorded arms: a name from configs/rigs/ or a YAML file.")
    ] = "single",
    out: Annotated[Path, typer.Option(help="The dataset to write.")] = Path("real"),
    kind: Annotated[
        Literal["csv", "lowdim", "raiden_raw", "lerobot", "mcap", "maker", "abc_training"] | None,
        typer.Option("--format", help="Format of the recordings.  [default: detected]"),
    ] = None,
    mapping: Annotated[
        str | None,
        typer.Option(help="Names of the columns: a name from configs/recordings/ or a YAML file.  [default: detected]"),
    ] = None,
    gripper: Annotated[
        Literal["metres", "share", "closed_share"] | None,
        typer.Option(
            help="Unit of openings: m of one finger; 0 closed .. 1 open; 0 open .. 1 closed.  [default: the format's]"
        ),
    ] = None,
    mirror_gripper: Annotated[
        Literal["measured", "commanded", "both"] | None,
        typer.Option(
            help="Openings that are reversed: 0 is open, and the largest value is closed.", show_default=False
        ),
    ] = None,
    degrees: Annotated[bool, typer.Option("--degrees", help="Joints are in degrees.")] = False,
    swap_arms: Annotated[
        bool, typer.Option("--swap-arms", help="The left arm's measurements belong to the right arm, and the reverse.")
    ] = False,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="calibration.yaml of `yamsim calibrate`, or its directory; cameras' matrices and poses are stored.",
            show_default=False,
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Add to an existing dataset.")] = False,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Make a dataset from recordings of real arms, marked `source: real`. Missing data stays missing.

    Example: yamsim import log.csv --rig single --out real
    """
    mode = open_mode(resume=resume, overwrite=overwrite)
    where = session_opener.find_locations()
    session_opener.disable_gl()
    settings = session_opener.load_rig(rig, where)

    from yamsim_cli.real.import_recording.importing import Corrections, ImportRequest, import_recordings

    corrections = Corrections(degrees, swap_arms, gripper, mirror_gripper)
    cameras = _known_cameras(calibration, settings, where) if calibration else {}
    request = ImportRequest(source, settings, kind, mapping, corrections, out, mode, cameras)
    with progress_bar("import", "episodes") as advance:
        report = import_recordings(request, where, advance)
    if json:
        print_json(report.to_json_data())
        return
    note_moved(out, report.moved_aside)
    for episode, problems in report.problems.items():
        for problem in problems:
            print_note(f"{episode}: {problem}")
    kept = f", {report.kept_episodes} were there before" if report.kept_episodes else ""
    print_line(
        f"{report.path}: {count_noun(report.episodes, 'episode')}, {count_noun(report.frames, 'frame')}{kept}, "
        "source: real"
    )


def _known_cameras(path: Path, rig: RigConfig, locations: Locations) -> dict[str, KnownCamera]:
    import numpy as np

    from yamsim_cli.calibration.calibration_file import load_calibration
    from yamsim_cli.real.import_recording.importing import KnownCamera

    found = load_calibration(path, locations).for_rig(rig, "--calibration")
    found.require_fixed_cameras()
    return {
        one.name: KnownCamera(np.array(one.K), (one.width, one.height), one.T_cam_in_base, any(one.distortion))
        for one in found.cameras
    }
