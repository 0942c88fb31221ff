"""`yamsim match`: a scene from photos of a station."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, Margin, Offline, Revision, RigName, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.match.match_run import StationMatch


def match(
    photos: Annotated[
        list[Path], typer.Argument(help="Photos of one fixed camera, or folders of them.", show_default=False)
    ],
    rig: RigName = "single",
    revision: Revision = None,
    margin: Margin = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE[:CAMERA]",
            help="Calibration of the camera, as for `yamsim overlay`; the arms' boards give its pose.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR|FILE|FILE:CAMERA",
            help="In place of --camera, a calibration of `yamsim calibrate`: its camera, bases and joint offsets "
            "replace the arms' boards.",
        ),
    ] = None,
    calibrated_camera: Annotated[
        str | None, typer.Option(help="With --calibration: the camera that took the photos, if there are several.")
    ] = None,
    joints: Annotated[
        Path | None,
        typer.Option(help="Joints in rad, one row for all photos or one for each: .npy or .yaml.  [default: home]"),
    ] = None,
    scene: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Scene with the table's place and size, and the floor's height.")
    ] = "tabletop",
    mask_image: Annotated[
        Path | None, typer.Option(help="Your mask of the robot, or a folder of masks, for the score.")
    ] = None,
    min_iou: Annotated[
        float | None, typer.Option(min=0, max=1, help="Exit code 5 if the overlap is smaller; needs --mask-image.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for matched.yaml, match.json and the page.")] = Path("matched"),
    overwrite: Overwrite = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Make a scene from photos of a station: the photo as background, the table's surface, and the light.

    Example: yamsim match photos/ --rig single --camera camera.yaml --joints joints.yaml
    """
    if (camera is None) == (calibration is None):
        raise UsageError("give either --camera or --calibration")
    if calibrated_camera and calibration is None:
        raise UsageError("--calibrated-camera needs --calibration")
    if min_iou is not None and mask_image is None:
        raise UsageError("--min-iou needs --mask-image")
    from yamsim_cli.match.match_report import match_files, report_data, require_overlap, write_match

    require_unused_paths("--out", match_files(out), overwrite=overwrite)
    where = session_opener.find_locations()
    settings = session_opener.load_rig(rig, where, margin, revision)

    from yamsim_cli.calibration.calibration_file import load_placed_camera
    from yamsim_cli.core.config.cameras.camera import CameraConfig
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig

    model = load_config(CameraConfig, "cameras", camera, where).camera_model if camera else None
    surroundings, studio = (load_config(SceneConfig, "scenes", name, where) for name in (scene, "studio"))
    quality = load_config(RenderConfig, "quality", "balanced", where)
    placed = None
    if calibration is not None:
        flag = "--calibrated-camera"
        _, placed = load_placed_camera(calibration, calibrated_camera, settings, where, option=flag, remedy=flag)
    session_opener.choose_gl_backend(where)

    from yamsim_cli.core.scene.blueprint import Blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.match.match_run import MatchRequest, match_station
    from yamsim_cli.photos.overlay.joint_files import load_postures
    from yamsim_cli.photos.overlay.photos import find_photos

    postures = load_postures(joints, settings) if joints else None
    request = MatchRequest(find_photos(photos), postures, model, placed, mask_image)
    where = session_opener.with_mesh_folders(where, visual_mesh_sets(Blueprint(settings, surroundings)))
    with progress_bar("matching", "steps") as advance:
        done = match_station(settings, surroundings, studio, quality, request, where, advance)
    write_match(done, out)
    if json:
        print_json(report_data(done) | {"scene": str(out / "matched.yaml")})
    else:
        _print(done, out)
    require_overlap(done, min_iou)


def _print(done: StationMatch, out: Path) -> None:
    for photo in done.photos:
        overlap = "" if photo.iou is None else f", IoU {photo.iou:.3f}"
        print_line(
            f"{photo.path}: outline {photo.outline_px:.2f} px{overlap}, colours of the arms {photo.arms_before:.1f} -> "
            f"{photo.arms_after:.1f}, of the image {photo.all_before:.1f} -> {photo.all_after:.1f} of 255"
        )
    if done.light is None:
        print_note("the photos show too little of the arms to estimate the light; the scene keeps the light of --scene")
    if done.plate.filled_share:
        print_note(
            f"the arms hide {100 * done.plate.filled_share:.1f} % of the background in every photo; this part is "
            "filled with the colours around it; add photos with the arms elsewhere"
        )
    if not done.has_table_photo:
        print_note(
            "the photos show too little of the table to estimate its colour; the table keeps the colour of --scene"
        )
    for text in done.notes:
        print_note(text)
    print_line(f"{out / 'matched.yaml'}: for `yamsim record --scene`; {out / 'match.html'} shows photo and match")
