from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError, count_noun
from yamsim_cli.flags.output_files import RenameExisting
from yamsim_cli.flags.selection_file import SelectionFile, Who, selection_of
from yamsim_cli.flags.session_options import Json, Offline, Revision, session_opener
from yamsim_cli.terminal.console import note_moved, print_json, print_line, print_note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.correction_record import Actor
    from yamsim_cli.export.export_source import ActionSource, RealSource, SimulatedSource
    from yamsim_cli.export.output_directory import ExportResult
    from yamsim_cli.export.raiden_schema import RaidenOptions
    from yamsim_cli.selection import AppliedSelection

_MAX_FPS = 500  # frames/s: the rate of physics steps

app = typer.Typer(help="Write a dataset or a calibration in the formats of other programs.", no_args_is_help=True)

Dataset = Annotated[
    Path, typer.Argument(help="The directory that `yamsim record` or `yamsim import` wrote.", show_default=False)
]
Out = Annotated[Path, typer.Argument(help="Directory to create.", show_default=False)]
Episodes = Annotated[
    str | None, typer.Option(metavar="LIST", help="Numbers of the episodes, such as 0,3,5-9.  [default: all]")
]
RealFps = Annotated[
    float | None,
    typer.Option(
        "--fps",
        min=1,
        max=_MAX_FPS,
        help="Real recordings: rate of evenly spaced frames, each the nearest recorded one.  [default: the recorded "
        "frames]",
        show_default=False,
    ),
]
RealActions = Annotated[
    Literal["recorded", "measured", "none"] | None,
    typer.Option(
        help="Real recordings: the commands, the joints measured one frame later, or none.  [default: recorded]",
        show_default=False,
    ),
]

StationActions = Annotated[
    Literal["recorded", "measured"] | None,
    typer.Option(
        "--actions",
        help="Real recordings: the commands, or the joints measured one frame later.  [default: recorded]",
        show_default=False,
    ),
]
Top = Annotated[
    str | None,
    typer.Option(
        metavar="CAMERA", help="Camera with the role `top`.  [default: the only one not on a wrist]", show_default=False
    ),
]
Encoders = Annotated[int, typer.Option(min=1, help="Number of processes that encode.")]


@app.callback()
def _export() -> None:
    """Write a dataset in the formats of other programs. OUT is written completely or not at all."""


@app.command()
def raiden(
    dataset: Dataset,
    out: Out,
    fps: Annotated[str, typer.Option(metavar="RATE", help="Frames a second, or `source`: the recorded frames.")] = "30",
    pictures: Annotated[
        Literal["draw", "nearest"] | None,
        typer.Option(
            help="Pictures at the frames' times: rendered anew (draw), or the nearest recorded pictures.  "
            "[default: draw]",
            show_default=False,
        ),
    ] = None,
    images: Annotated[
        Literal["png", "jpg"],
        typer.Option(help="Format of the pictures. raiden reads only PNG; jpg with --fps source copies the recording."),
    ] = "png",
    single: Annotated[
        bool, typer.Option("--single", help="Arrays with only one arm: 7 and 13 numbers wide, not 14 and 26.")
    ] = False,
    hand_frame: Annotated[
        Literal["yamsim", "i2rt"],
        typer.Option(help="Hand poses by the simulated arm's kinematics, or by raiden's for the same joints."),
    ] = "yamsim",
    workers: Annotated[int, typer.Option(min=1, help="Number of processes that render.")] = 2,
    actions: RealActions = None,
    episodes: Episodes = None,
    selection: SelectionFile = None,
    who: Who = None,
    overwrite: RenameExisting = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Write the converted layout of TRI's raiden, by default at 30 frames a second. A single arm becomes the left arm.

    Example: yamsim export raiden dataset/ real_layout/
    """
    from yamsim_cli.core.dataset.imported_records import is_imported_dataset
    from yamsim_cli.export.raiden_schema import RaidenOptions

    if fps == "source" and pictures:
        raise UsageError(
            f"--pictures {pictures} does not apply to --fps source, which exports the recorded pictures; leave one "
            "of them out"
        )
    options = RaidenOptions(_parse_fps(fps), pictures or "draw", images, single, hand_frame)
    chosen = selection_of(dataset, selection, who)
    if is_imported_dataset(dataset):
        if pictures == "draw":
            raise UsageError(
                f"--pictures draw: {dataset} is real, so only its recorded pictures can be exported; give nearest"
            )
        done = _real_raiden(dataset, out, options, actions, episodes, chosen, overwrite)
    else:
        _require_real("--actions", actions, dataset)
        done = _simulated_raiden(dataset, out, options, workers, episodes, chosen, overwrite)
    _print(done, json, chosen)


def _simulated_raiden(
    dataset: Path,
    out: Path,
    options: RaidenOptions,
    workers: int,
    episodes: str | None,
    selection: AppliedSelection | None,
    overwrite: bool,
) -> ExportResult:
    where = session_opener.find_locations()
    if options.renders_images:
        where = _with_renderer(where)
    else:
        session_opener.disable_gl()

    from yamsim_cli.core.config.session import Session
    from yamsim_cli.export.export_source import open_source
    from yamsim_cli.export.raiden import export_raiden

    source = open_source(dataset, episodes, where, selection)
    if options.renders_images:
        where = session_opener.with_scene_meshes(Session(source.config, where)).locations
    with progress_bar("exporting", "episodes") as advance:
        return export_raiden(source, out, where, advance, options, workers=workers, overwrite=overwrite)


def _real_raiden(
    dataset: Path,
    out: Path,
    options: RaidenOptions,
    actions: ActionSource | None,
    episodes: str | None,
    selection: AppliedSelection | None,
    overwrite: bool,
) -> ExportResult:
    session_opener.disable_gl()

    from yamsim_cli.export.export_source import open_real_source
    from yamsim_cli.export.raiden import export_real_raiden

    where = session_opener.find_locations()
    source = open_real_source(dataset, episodes, where, options.fps, selection)
    with progress_bar("exporting", "episodes") as advance:
        return export_real_raiden(source, out, where, advance, options, actions or "recorded", overwrite=overwrite)


@app.command()
def lerobot(
    dataset: Dataset,
    out: Out,
    fps: RealFps = None,
    actions: RealActions = None,
    environment_state: Annotated[
        bool,
        typer.Option("--environment-state", help="Also write the objects' poses, as observation.environment_state."),
    ] = False,
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Write videos, and the cameras' matrices.")
    ] = True,
    episodes: Episodes = None,
    selection: SelectionFile = None,
    who: Who = None,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Write a LeRobotDataset v3.0 of Parquet and H.264, with frame k at exactly k frame periods.

    The left arm comes first. An action of drive commands ends with the state of each arm's weld, which holds an object.

    Example: yamsim export lerobot dataset/ lerobot_dataset/
    """
    source = _open_dataset(dataset, episodes, selection, who, fps, actions)

    from yamsim_cli.export.lerobot import export_lerobot

    with progress_bar("exporting", "episodes") as advance:
        done = export_lerobot(
            source,
            out,
            advance,
            pictures=pictures,
            environment_state=environment_state,
            actions=actions or "recorded",
            overwrite=overwrite,
        )
    _print(done, json, source.selection)


@app.command()
def maker(
    dataset: Dataset,
    out: Out,
    fps: RealFps = None,
    actions: StationActions = None,
    top: Top = None,
    workers: Encoders = 2,
    episodes: Episodes = None,
    selection: SelectionFile = None,
    who: Who = None,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Write the episodes of the maker's yam-abc-reproduce, as TASK/ep_000000/. A single arm becomes the left arm.

    Example: yamsim export maker dataset/ maker_episodes/
    """
    source = _open_dataset(dataset, episodes, selection, who, fps, actions)

    from yamsim_cli.export.maker import export_maker

    with progress_bar("exporting", "episodes") as advance:
        done = export_maker(
            source, out, advance, actions=actions or "recorded", top=top, workers=workers, overwrite=overwrite
        )
    _print(done, json, source.selection)


@app.command()
def abc(
    dataset: Dataset,
    out: Out,
    layout: Annotated[
        Literal["release", "training"],
        typer.Option(help="One MCAP file an episode, or the layout that ABC's trainer reads."),
    ] = "release",
    actions: StationActions = None,
    top: Top = None,
    workers: Encoders = 2,
    episodes: Episodes = None,
    selection: SelectionFile = None,
    who: Who = None,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Write episodes in the formats of ABC-130k (MCAP) and of ABC's trainer. A single arm becomes the left arm.

    Example: yamsim export abc dataset/ abc_release/
    """
    source = _open_dataset(dataset, episodes, selection, who, actions=actions)

    from yamsim_cli.export.abc import export_abc

    with progress_bar("exporting", "episodes") as advance:
        done = export_abc(
            source,
            out,
            advance,
            layout=layout,
            actions=actions or "recorded",
            top=top,
            workers=workers,
            overwrite=overwrite,
        )
    _print(done, json, source.selection)


@app.command()
def mp4(
    dataset: Dataset,
    out: Annotated[
        Path, typer.Argument(help="Directory of videos to create; with --sheet a FILE.jpg.", show_default=False)
    ],
    camera: Annotated[
        list[str] | None, typer.Option(help="Camera to show; may be repeated: images are side by side.  [default: all]")
    ] = None,
    sheet: Annotated[
        bool, typer.Option("--sheet", help="Write one image with a row for each episode, in place of videos.")
    ] = False,
    columns: Annotated[int, typer.Option(min=1, max=100, help="With --sheet: images in a row.")] = 8,
    width: Annotated[int, typer.Option(min=16, max=1920, help="With --sheet: width of each image, px.")] = 160,
    speed: Annotated[
        float, typer.Option(min=0.01, max=1000, help="Playback speed of the videos; 0.5 is slow motion.")
    ] = 1.0,
    fps: RealFps = None,
    episodes: Episodes = None,
    selection: SelectionFile = None,
    who: Who = None,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Write a video of each episode, or a contact sheet of all episodes.

    Example: yamsim export mp4 dataset/ videos/
    """
    source = _open_dataset(dataset, episodes, selection, who, fps)

    from yamsim_cli.export.videos import export_mp4, export_sheet

    with progress_bar("exporting", "episodes") as advance:
        if sheet:
            done = export_sheet(source, out, camera or (), advance, columns=columns, width=width, overwrite=overwrite)
        else:
            done = export_mp4(source, out, camera or (), advance, speed=speed, overwrite=overwrite)
    _print(done, json, source.selection)


@app.command()
def rerun(
    dataset: Dataset,
    out: Out,
    episodes: Episodes = None,
    selection: SelectionFile = None,
    who: Who = None,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Write an .rrd file of each episode for the rerun viewer: images, joints, poses and camera frusta.

    Example: yamsim export rerun dataset/ rrd/ --episodes 0-9
    """
    source = _open_dataset(dataset, episodes, selection, who)

    from yamsim_cli.export.rrd import export_rerun

    with progress_bar("exporting", "episodes") as advance:
        done = export_rerun(source, out, advance, overwrite=overwrite)
    _print(done, json, source.selection)


@app.command()
def calibration(
    calibration: Annotated[
        Path,
        typer.Argument(help="calibration.yaml of `yamsim calibrate`, or its directory.", show_default=False),
    ],
    out: Out,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="ros, kalibr, raiden or inspect_robots; may be repeated.  [default: all that fit]",
            show_default=False,
        ),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(help="Rig that `yamsim calibrate` was given.  [default: the calibration's]", show_default=False),
    ] = None,
    revision: Revision = None,
    overwrite: RenameExisting = False,
    json: Json = False,
) -> None:
    """Write a station's calibration in formats of other programs, as OUT/FORMAT/, and report values that do not fit.

    Example: yamsim export calibration calibration/calibration.yaml exported/ --format ros
    """
    session_opener.disable_gl()

    from yamsim_cli.calibration.calibration_file import load_calibration
    from yamsim_cli.calibration.export_formats.formats import make_files, require_formats, write_files

    require_formats(formats or ())
    where = session_opener.find_locations()
    found = load_calibration(calibration, where)
    settings = _rig_of_calibration(rig, found.rig, revision, where)
    made = make_files(found, settings, where, formats or ())
    moved = write_files(made, out, overwrite=overwrite)
    left_out = [line for one in made.values() for line in one.left_out]
    for line in left_out:
        print_note(f"left out: {line}")
    note_moved(out, moved)
    written = {name: sorted(one.files) for name, one in made.items() if one.files}
    if json:
        report = {"path": str(out), "formats": written, "left_out": left_out}
        print_json(report | {"moved_aside": str(moved) if moved else None})
    else:
        print_line(f"{', '.join(written)}: {count_noun(sum(map(len, written.values())), 'file')} in {out}")


def _rig_of_calibration(name: str | None, own: str, revision: str | None, locations: Locations) -> RigConfig:
    """Return the rig `name`, or that with the calibration's own name, which ROBOT+GRIPPER and files do not have."""
    if name is not None:
        return session_opener.load_rig(name, locations, revision=revision)
    try:
        return session_opener.load_rig(own, locations, revision=revision)
    except ConfigError as error:
        raise ConfigError(f"{error}; give --rig as for `yamsim calibrate`") from None


def _parse_fps(text: str) -> float | None:
    if text == "source":
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 1 <= rate <= _MAX_FPS:
        raise UsageError(f"--fps {text!r} is not valid: give a number in 1..{_MAX_FPS}, such as 30, or source")
    return rate


def _with_renderer(locations: Locations) -> Locations:
    """Choose an OpenGL backend, which sets the quality `auto`. The error names flags that avoid rendering."""
    try:
        return session_opener.choose_gl_backend(locations, workers=True)
    except ResourceError as error:
        raise ResourceError(f"{error}; or render nothing: give --pictures nearest or --fps source") from None


def _open_dataset(
    dataset: Path,
    episodes: str | None,
    selection: Path | None,
    who: Actor | None,
    fps: float | None = None,
    actions: ActionSource | None = None,
) -> SimulatedSource | RealSource:
    session_opener.disable_gl()

    from yamsim_cli.core.dataset.imported_records import is_imported_dataset
    from yamsim_cli.export.export_source import open_real_source, open_source

    where, chosen = session_opener.find_locations(), selection_of(dataset, selection, who)
    if is_imported_dataset(dataset):
        return open_real_source(dataset, episodes, where, fps, chosen)
    _require_real("--fps", fps, dataset)
    _require_real("--actions", actions, dataset)
    return open_source(dataset, episodes, where, chosen)


def _require_real(flag: str, value: object, dataset: Path) -> None:
    if value is not None:
        raise UsageError(
            f"{flag} is for real recordings, and {dataset} was simulated, with even times and all actions: leave it out"
        )


def _print(done: ExportResult, json: bool, selection: AppliedSelection | None) -> None:
    for line in done.notes:
        print_note(line)
    note_moved(done.path, done.moved_aside)
    if json:
        moved = str(done.moved_aside) if done.moved_aside else None
        report = {"path": str(done.path), "episodes": done.episodes, "frames": done.frames, "moved_aside": moved}
        print_json(report | {"notes": list(done.notes), "selection": selection and selection.report()})
    else:
        print_line(f"{count_noun(done.episodes, 'episode')}, {count_noun(done.frames, 'frame')} in {done.path}")
