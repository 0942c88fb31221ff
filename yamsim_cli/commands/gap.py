from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.output_files import Overwrite, ReportFile, require_unused_reports, write_json_report
from yamsim_cli.flags.session_options import Json, Margin, Offline, Revision, Robot, StationCalibration, session_opener
from yamsim_cli.terminal.console import print_note, print_report, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.core.recorded_motion import RecordedMotion
    from yamsim_cli.gap_photos.photo_comparison import PhotoRequest
    from yamsim_cli.real.gap.gap_figures import MotionGap
    from yamsim_cli.real.gap.gap_page import CaptionedJpeg


def gap(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            help="Each a CSV, an episode, a dataset with all its episodes, or another file that `yamsim import` reads.",
            show_default=False,
        ),
    ],
    rig: Annotated[
        str | None,
        typer.Option(help="A name from configs/rigs/ or a YAML file.  [default: single, or an episode's own]"),
    ] = None,
    revision: Revision = None,
    robot: Robot = None,
    margin: Margin = None,
    mapping: Annotated[
        str | None,
        typer.Option(
            help="Names of a recording's columns: a name from configs/recordings/ or a YAML file.  [default: detected]"
        ),
    ] = None,
    begin: Annotated[
        float | None,
        typer.Option("--from", min=0, metavar="S", help="Compare from this time on, s after the first sample."),
    ] = None,
    end: Annotated[
        float | None,
        typer.Option("--to", min=0, metavar="S", help="Compare up to this time, s after the first sample."),
    ] = None,
    pictures: Annotated[
        int, typer.Option(min=0, metavar="N", help="Also compare up to N photos of the recordings.")
    ] = 0,
    camera: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE[:CAMERA]", help="The photos' calibration, in place of the recording's own."),
    ] = None,
    calibration: StationCalibration = None,
    episode_camera: Annotated[
        str | None, typer.Option(help="Camera whose photos are compared.  [default: the fixed camera]")
    ] = None,
    fail_above: Annotated[
        float | None,
        typer.Option(min=0, metavar="MRAD", help="Exit code 5 if a joint's RMS error is above this value."),
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Also write a page with curves and pictures.")] = None,
    overwrite: Overwrite = False,
    out: ReportFile = None,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Simulate recorded commands, and report the distance between measured and simulated joints.

    Example: yamsim gap log.csv --rig single --html gap.html
    """
    if begin is not None and end is not None and begin >= end:
        raise UsageError(f"--from {begin:g} and --to {end:g}: --from must be below --to")
    if (camera or episode_camera or calibration) and not pictures:
        raise UsageError("--camera, --calibration and --episode-camera are for photos; give --pictures N with them")
    if camera and calibration:
        raise UsageError("--camera and --calibration both say how the photos were taken; leave one out")
    require_unused_reports(out, html, overwrite=overwrite)
    where = session_opener.find_locations()
    settings = _choose_rig(rig, revision, robot, margin, recordings[0], where)

    from yamsim_cli.core.config.cameras.camera import CameraConfig
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.scene import SceneConfig

    surroundings = load_config(SceneConfig, "scenes", "studio", where)
    model = load_config(CameraConfig, "cameras", camera, where).camera_model if camera else None
    placed = None
    if calibration:
        from yamsim_cli.calibration.calibration_file import load_placed_camera

        episode_camera, placed = load_placed_camera(calibration, episode_camera, settings, where)
    if pictures:
        where = session_opener.choose_gl_backend(where)
    else:
        session_opener.disable_gl()

    from yamsim_cli.real.gap.report import build_report, require_gap_below

    motions, problems = _read_motions(recordings, settings, where, mapping)
    gaps = _measure_gaps(motions, settings, surroundings, where, (begin or 0.0, math.inf if end is None else end))
    report = build_report(gaps, settings.name)
    report["problems"] = problems
    shown: list[CaptionedJpeg] = []
    if pictures:
        from yamsim_cli.gap_photos.photo_comparison import PhotoRequest

        request = PhotoRequest(pictures, model, episode_camera, placed)
        report["pictures"], shown = _compare_with_photos(gaps, settings, request, surroundings, where)
    if html:
        from yamsim_cli.real.gap.report import write_gap_page

        write_gap_page(report, gaps, shown, html)
        report["html"] = str(html)
        print_note(f"The page is in {html}.")
    write_json_report(report, out)
    from yamsim_cli.terminal.gap_table import gap_tables

    print_report(report, lambda: gap_tables(report), json)
    require_gap_below(report, fail_above)


def _read_motions(
    recordings: Sequence[Path], rig: RigConfig, locations: Locations, mapping: str | None
) -> tuple[list[RecordedMotion], list[dict[str, Any]]]:
    """Return motions, and faults as JSON data, which also go to stderr."""
    from yamsim_cli.real.recordings.motion_faults import find_faults, require_units
    from yamsim_cli.real.recordings.motion_reading import read_motions

    motions = read_motions(recordings, rig, locations, mapping)
    problems = [(motion.name, problem) for motion in motions for problem in find_faults(motion, rig)]
    for name, problem in problems:
        require_units(name, [problem])
    for name, problem in problems:
        print_note(f"{name}: {problem.text}")
    return motions, [
        {"recording": name, "fault": str(problem.fault), "time_s": problem.time, "text": problem.text}
        for name, problem in problems
    ]


def _choose_rig(
    name: str | None,
    revision: str | None,
    robot: list[str] | None,
    margin: float | None,
    recording: Path,
    locations: Locations,
) -> RigConfig:
    """Return the named rig, or else the rig of the recording's dataset, or else `single`."""
    from yamsim_cli.core.dataset.dataset_paths import CONFIG_FILE
    from yamsim_cli.core.dataset.imported_records import is_imported_dataset, read_imported_config
    from yamsim_cli.core.dataset.reader import read_recording_config

    datasets = [path for path in (recording, recording.absolute().parent) if (path / CONFIG_FILE).is_file()]
    if name is None and recording.is_dir() and datasets:
        if margin is not None or revision is not None or robot:
            raise UsageError("--margin, --revision and --robot need --rig; give --rig with them")
        return (read_imported_config if is_imported_dataset(datasets[0]) else read_recording_config)(
            datasets[0], locations
        ).rig
    return session_opener.load_rig(name or "single", locations, margin, revision, robot)


def _measure_gaps(
    motions: Sequence[RecordedMotion],
    rig: RigConfig,
    surroundings: SceneConfig,
    locations: Locations,
    part: tuple[float, float],
) -> list[MotionGap]:
    from yamsim_cli.core.scene.build import build_rig_scene
    from yamsim_cli.real.gap.gap_figures import measure_gap

    scene = build_rig_scene(rig, surroundings, locations)
    gaps = []
    with progress_bar("gap", "recordings") as advance:
        for k, motion in enumerate(motions):
            advance(k, len(motions))
            gaps.append(measure_gap(scene, motion, *part))
        advance(len(motions), len(motions))
    return gaps


def _compare_with_photos(
    gaps: Sequence[MotionGap], rig: RigConfig, request: PhotoRequest, surroundings: SceneConfig, locations: Locations
) -> tuple[dict[str, Any], list[CaptionedJpeg]]:
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.scene.compose import rig_mesh_sets
    from yamsim_cli.gap_photos.photo_comparison import compare_photos

    quality = load_config(RenderConfig, "quality", "fast", locations)
    locations = session_opener.with_mesh_folders(locations, rig_mesh_sets(rig))
    with progress_bar("photos", "photos") as advance:
        return compare_photos(gaps, rig, request, surroundings, quality, locations, advance)
