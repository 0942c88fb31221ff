from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, Margin, Offline, Revision, StationCalibration, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.photos.overlay.overlay_report import OverlayReport


def overlay(
    img: Annotated[list[Path] | None, typer.Option(help="A photo or a folder of photos; may be repeated.")] = None,
    rig: Annotated[
        str | None,
        typer.Option(help="A name from configs/rigs/ or a YAML file.  [default: single, or an episode's own]"),
    ] = None,
    revision: Revision = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE[:CAMERA]",
            help="Calibration: yamsim's, or a file of OpenCV, ROS, Kalibr or raiden; else estimated from the boards.",
        ),
    ] = None,
    calibration: StationCalibration = None,
    joints: Annotated[
        Path | None, typer.Option(help="Joints in rad: .npy, .yaml or a lowdim .pkl.  [default: home]")
    ] = None,
    episode: Annotated[
        list[Path] | None,
        typer.Option(help="A recorded episode, DATASET/ep_NNNNNN, or a dataset, instead of --img; may be repeated."),
    ] = None,
    episode_camera: Annotated[
        str | None, typer.Option(help="The episode's camera.  [default: the fixed camera]")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Use every N-th photo.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder for the pictures and overlay.json.")] = Path("overlays"),
    margin: Margin = None,
    trust_margin: Annotated[
        bool, typer.Option("--trust-margin", help="Take the rig's margin as exact: all boards together give one pose.")
    ] = False,
    refine: Annotated[bool, typer.Option("--refine", help="Adjust each pose to the photo's edges.")] = False,
    mask: Annotated[
        bool, typer.Option("--mask", help="Also write a mask: 1 and 2 for the first and the second arm, else 0.")
    ] = False,
    mask_image: Annotated[Path | None, typer.Option(help="Your mask of the robot, or a folder of masks.")] = None,
    max_turn: Annotated[
        float, typer.Option(min=0, help="Largest standard deviation of the rotation of a certain pose, degrees.")
    ] = 1.5,
    max_shift: Annotated[
        float, typer.Option(min=0, help="Largest standard deviation of the position of a certain pose, mm.")
    ] = 10.0,
    max_reprojection: Annotated[
        float | None, typer.Option(min=0, help="Exit code 4 if a board's reprojection error is larger, px.")
    ] = None,
    min_iou: Annotated[
        float | None, typer.Option(min=0, max=1, help="Exit code 4 if the overlap is smaller; needs --mask-image.")
    ] = None,
    fail_if_moved: Annotated[
        bool, typer.Option("--fail-if-moved", help="Exit code 4 if the camera or a base was moved between photos.")
    ] = False,
    opacity: Annotated[float, typer.Option(min=0, max=1, help="Opacity of the rendered arms.")] = 0.55,
    video: Annotated[Path | None, typer.Option(help="Also write an MP4 of all pictures.")] = None,
    fps: Annotated[float, typer.Option(min=0.1, max=240, help="Pictures a second in the MP4.")] = 15.0,
    overwrite: Overwrite = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Estimate each arm's pose in photos from its board, draw the simulated arm over the photos, and score the fit.

    Example: yamsim overlay --img photo.png --rig russet --camera camera.yaml
    """
    if bool(img) == bool(episode):
        raise UsageError("give either --img or --episode")
    if episode_camera and not episode:
        raise UsageError("--episode-camera needs --episode")
    if camera and episode:
        raise UsageError("--camera needs --img; a recorded episode has its own camera")
    if camera and calibration:
        raise UsageError("--camera and --calibration exclude each other; give one of them")
    if min_iou is not None and mask_image is None:
        raise UsageError("--min-iou needs --mask-image")
    if video is not None:
        require_unused_paths("--video", video, overwrite=overwrite)
    where = session_opener.find_locations()
    settings = _choose_rig(rig, revision, episode or [], margin, where)

    from yamsim_cli.core.config.cameras.camera import CameraConfig
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig

    model = load_config(CameraConfig, "cameras", camera, where).camera_model if camera else None
    placed = None
    if calibration:
        from yamsim_cli.calibration.calibration_file import load_placed_camera

        episode_camera, placed = load_placed_camera(calibration, episode_camera, settings, where)
    scene = load_config(SceneConfig, "scenes", "studio", where)
    quality = load_config(RenderConfig, "quality", "fast", where)
    session_opener.choose_gl_backend(where)

    from yamsim_cli.core.scene.blueprint import Blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.photos.fiducials.board_detection import PoseLimits
    from yamsim_cli.photos.overlay.joint_files import load_postures
    from yamsim_cli.photos.overlay.overlay_run import OverlayRequest, photo_jobs, run_overlays
    from yamsim_cli.photos.overlay.photos import Photo, find_photos, recorded_photos

    photos = (
        recorded_photos(episode, episode_camera, settings, placed)
        if episode
        else [Photo(path, placed=placed) for path in find_photos(img or [])]
    )
    postures = load_postures(joints, settings) if joints else None
    if placed and postures:
        postures = [placed.true_postures(one) for one in postures]
    request = OverlayRequest(
        photo_jobs(photos[::every], out, postures=postures, write_masks=mask, mask_images=mask_image),
        out,
        placed.camera if placed else model,
        trust_margin=trust_margin,
        refine=refine,
        opacity=opacity,
        limits=PoseLimits(math.radians(max_turn), max_shift / 1000),
        output_video=video,
        frame_period=1 / fps,
        max_reprojection=max_reprojection,
        min_iou=min_iou,
        fail_if_moved=fail_if_moved,
    )
    require_unused_paths("--out", request.output_files, overwrite=overwrite)
    where = session_opener.with_mesh_folders(where, visual_mesh_sets(Blueprint(settings, scene)))
    with progress_bar("overlays", "photos") as advance:
        report = run_overlays(settings, request, scene, quality, where, advance)
    if json:
        print_json(report.to_json_data())
    else:
        _print(report)
    report.raise_for_failures()


def _choose_rig(
    name: str | None, revision: str | None, recordings: Sequence[Path], margin: float | None, locations: Locations
) -> RigConfig:
    """Return the named rig, or else the rig of the recordings' dataset, or else `single`."""
    from yamsim_cli.core.dataset.dataset_paths import CONFIG_FILE
    from yamsim_cli.core.dataset.reader import read_recorded_rig

    datasets = {path.resolve() if (path / CONFIG_FILE).is_file() else path.resolve().parent for path in recordings}
    if name is None and len(datasets) > 1:
        raise UsageError("--episode: the episodes are of several datasets; give --rig")
    if name is None and any((dataset / CONFIG_FILE).is_file() for dataset in datasets):
        if margin is not None:
            raise UsageError(f"--margin {margin:g}: an episode has the rig of its recording; give --rig with --margin")
        if revision is not None:
            raise UsageError(
                f"--revision {revision}: an episode has the rig of its recording; give --rig with --revision"
            )
        return read_recorded_rig(datasets.pop(), locations)
    return session_opener.load_rig(name or "single", locations, margin, revision)


def _print(report: OverlayReport) -> None:
    from yamsim_cli.photos.overlay.move_detection import describe_move
    from yamsim_cli.photos.overlay.overlay_report import photo_captions

    for result in report.results:
        for caption in photo_captions(result):
            print_line(f"{result.path}: {caption}")
        for arm in result.arms:
            # If no arm of a photo has a pose, the error at the end gives the reason.
            if result.base_poses and not arm.is_located and arm.detection:
                print_note(f"{result.path}: {arm.name}: {arm.detection.failure_explanation}")
        for text in result.notes:
            print_note(f"{result.path}: {text}")
    for move in report.move_report.moves:
        print_line(describe_move(move))
    if not report.move_report.why_unknown and not report.move_report.moves:
        print_line(f"camera and bases stayed where they were in all {len(report.results)} photos")
    print_line(f"{len(report.files)} files, such as {report.files[0]}")
