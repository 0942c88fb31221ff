from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import UsageError, suggest_similar
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, Margin, Offline, Revision, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.calibration.calibrate_run import CalibrationRequest
    from yamsim_cli.calibration.episode_pictures import EpisodePictures
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.core.geometry.camera import CameraModel


def calibrate(
    episodes: Annotated[
        list[Path],
        typer.Argument(
            help="Each an episode, a dataset with all its episodes, or a recording that `yamsim import` reads.",
            show_default=False,
        ),
    ],
    rig: Annotated[str, typer.Option(help="A name from configs/rigs/ or a YAML file.")],
    revision: Revision = None,
    margin: Margin = None,
    camera: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=FILE[:CAMERA]]",
            help="A camera of the episodes, with its calibration (as for overlay); may be repeated.  [default: all "
            "fixed cameras, with the recorded intrinsics; name wrist cameras to include them]",
        ),
    ] = None,
    mapping: Annotated[
        str | None, typer.Option(help="Names of a recording's columns, as for import.  [default: detected]")
    ] = None,
    near: Annotated[Path | None, typer.Option(help="An earlier calibration.yaml, whose poses are tried first.")] = None,
    check: Annotated[
        Path | None, typer.Option(help="Compare with this calibration.yaml; exit 5 if the pictures contradict it.")
    ] = None,
    frames: Annotated[int, typer.Option(min=16, max=200, help="Largest number of pictures of each camera.")] = 40,
    max_shift: Annotated[
        float,
        typer.Option(min=0, help="Largest half width of the position's 95 % interval, mm; else the pose is refused."),
    ] = 5.0,
    max_turn: Annotated[
        float,
        typer.Option(min=0, help="Largest half width of the turn's 95 % interval, degrees; else the pose is refused."),
    ] = 0.5,
    out: Annotated[Path, typer.Option(help="Folder for calibration.yaml, the page and the report.")] = Path(
        "calibration"
    ),
    overwrite: Overwrite = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Estimate the poses of cameras from episodes: from the arms in the pictures and the measured joints.

    Example: yamsim calibrate dataset --rig single --out calibration
    """
    if near is not None and check is not None:
        raise UsageError("--near and --check exclude each other; give one of them")
    where = session_opener.find_locations()
    settings = session_opener.load_rig(rig, where, margin, revision, None)
    where = session_opener.choose_gl_backend(where)

    from yamsim_cli.calibration.calibrate_run import StationCalibrator
    from yamsim_cli.calibration.calibration_file import load_calibration
    from yamsim_cli.calibration.calibration_report import (
        make_calibration,
        make_report,
        output_files,
        raise_for_refusals,
        require_agreement,
        result_lines,
        wrist_lines,
        write_page,
        write_results,
    )
    from yamsim_cli.calibration.episode_pictures import other_rigs, read_episode_pictures
    from yamsim_cli.calibration.exchanges import measure_wrist_cameras
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.scene.compose import rig_mesh_sets

    require_unused_paths("--out", output_files(out), overwrite=overwrite)
    earlier = near or check
    given = load_calibration(earlier, where).for_rig(settings, str(earlier)) if earlier else None
    if given is not None:
        given.require_fixed_cameras()
    found = read_episode_pictures(episodes, settings, where, mapping)
    if difference := other_rigs(found, settings.name):
        print_note(difference)
    request = _make_request(camera, found, settings, where, (frames, max_shift / 1000, math.radians(max_turn)))
    request = request.with_near(given)
    if check is not None and given is not None and not {one.name for one in given.cameras} & {*request.cameras}:
        raise UsageError(
            f"--check {check}: none of its cameras ({', '.join(one.name for one in given.cameras)}) is calibrated, so "
            "there is nothing to compare; name one of them with --camera"
        )
    scene = load_config(SceneConfig, "scenes", "studio", where)
    quality = load_config(RenderConfig, "quality", "fast", where)
    where = session_opener.with_mesh_folders(where, rig_mesh_sets(settings))
    with ExitStack() as stack, progress_bar("calibration", "cameras") as advance:
        calibrator = StationCalibrator(settings, found, request, (scene, quality, where), stack)
        moves = measure_wrist_cameras(found, settings)
        wrists = calibrator.estimate_wrist_cameras(moves)
        outcome = calibrator.run(advance)
        calibration = make_calibration(settings, outcome, wrists)
        report = make_report(settings, outcome, calibration, moves, wrists)
        page = write_page(settings, outcome, calibration, wrists)
    files = write_results(out, report, page, calibration)
    if fault := report["wrist_cameras_fault"]:
        print_note(fault)
    if json:
        print_json(report)
    else:
        for line in (*result_lines(outcome, calibration), *wrist_lines(wrists)):
            print_line(line)
        print_line(f"{len(files)} files, such as {files[-1]}")
    if check is not None and given is not None and calibration is not None:
        require_agreement(given, calibration)
    raise_for_refusals(outcome, wrists)


def _make_request(
    cameras: list[str] | None,
    episodes: list[EpisodePictures],
    rig: RigConfig,
    locations: Locations,
    limits: tuple[int, float, float],
) -> CalibrationRequest:
    """Return the request for the cameras of --camera, by default all that are on no wrist."""
    from yamsim_cli.calibration.calibrate_run import CalibrationRequest
    from yamsim_cli.calibration.episode_pictures import camera_names, require_cameras
    from yamsim_cli.core.config.cameras.camera import CameraConfig
    from yamsim_cli.core.config.loader import load_config

    wrists = {arm.wrist_camera_name for arm in rig.arms}
    known = camera_names(episodes)
    fixed = [name for name in known if name not in wrists and "wrist" not in name]
    models: dict[str, CameraModel] = {}
    names = []
    for text in cameras or fixed:
        name, _, file = text.partition("=")
        names.append(name)
        if file:
            models[name] = load_config(CameraConfig, "cameras", file, locations).camera_model
    if len(set(names)) < len(names):
        raise UsageError(f"--camera names a camera twice: {', '.join(names)}")
    require_cameras(names, episodes)
    on_wrist = tuple(name for name in names if name in wrists)
    if unknown := [name for name in names if name not in (*fixed, *wrists)]:
        raise UsageError(
            f"--camera {unknown[0]}: this is neither a fixed camera nor one of the rig's wrist cameras; "
            f"{suggest_similar(unknown[0], (*fixed, *sorted(wrists)))}"
        )
    if not names:
        raise UsageError(f"all cameras are on wrists: {', '.join(known)}; give episodes with a fixed camera")
    still = tuple(name for name in names if name not in on_wrist)
    return CalibrationRequest(still, models, *limits, wrist_cameras=on_wrist)
