"""The files of a calibration: `calibration.yaml`, a JSON report and a page with the arms over the pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config.rig import RigConfig
from ..core.errors import DatasetError, PartialJobError, SimulationError
from ..core.files.documents.json_text import json_text
from ..core.files.writing import write_outputs
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array, invert_pose, quat_from_rotation, rotation_vector
from ..core.images.jpeg import encode_jpeg
from ..core.markup import (
    Markup,
    captioned_jpeg,
    grid_section,
    html_page,
    html_section,
    html_table,
    html_tag,
    page_footer,
)
from ..core.statistics import Z95
from ..photos.picture_overlay import blend_arms
from .calibrate_run import EXCHANGED_OVERLAP, CameraOutcome, StationOutcome, outline_px
from .calibration_file import (
    CALIBRATION_FILE,
    CalibratedArm,
    CalibratedCamera,
    CalibratedWristCamera,
    Calibration,
    Numbers3,
    calibration_text,
)
from .exchanges import WristCameraMoves, wrist_camera_fault
from .station_fit import FitPriors, StationFit, rig_bases
from .uncertainty import PoseInterval, StationIntervals, is_measured
from .wrist_fit import WristFit, WristOutcome

REPORT_FILE, PAGE_FILE = "calibration.json", "calibration.html"
_SHOWN_FRAMES = 12  # pictures of a camera on the page
_OPACITY = 0.35  # of the arms over a picture, 0..1
_JPEG_QUALITY = 85  # 0..100
_PAGE_PX = 460  # width of a picture on the page
_UNKNOWN = "\N{EM DASH}"
_K1_HEAD = "k1, if estimated"  # heading of the distortion
_FIGURES_TEXT = (
    "\N{PLUS-MINUS SIGN} is the half width of a 95 % interval. The outline is the median distance of the rendered "
    "arms' outlines to the pictures' edges."
)


def _numbers(values: Array) -> Numbers3:
    a, b, c = (float(round(value, 6)) for value in values)
    return a, b, c


def _quat(T: Array) -> tuple[float, float, float, float]:
    w, x, y, z = (float(round(value, 8)) for value in quat_from_rotation(T[:3, :3]))
    return w, x, y, z


def _widths(interval: PoseInterval) -> dict[str, Numbers3]:
    return {
        "position_95_mm": _numbers(1000 * interval.position),
        "rotation_95_deg": _numbers(np.degrees(interval.turn)),
    }


def make_calibration(
    rig: RigConfig, outcome: StationOutcome, wrists: Sequence[WristOutcome] = ()
) -> Calibration | None:
    """Return the calibration of all cameras with a certain pose, or None if there is no such camera.

    Without a certain fixed camera, bases and joint offsets are those assumed before the fit.
    """
    fit, intervals = outcome.fit, outcome.intervals
    certain = [one for one in outcome.cameras if one.refusal is None]
    cameras: tuple[CalibratedCamera, ...] = ()
    if fit is not None and intervals is not None and certain:
        cameras = tuple(_calibrated_camera(one, outcome.fitted.index(one.name), fit, intervals) for one in certain)
        arms = tuple(_calibrated_arm(arm.name, number, fit, intervals) for number, arm in enumerate(rig.arms))
    elif any(one.fit and one.refusal is None for one in wrists):
        arms = tuple(_assumed_arm(rig, number) for number in range(len(rig.arms)))
    else:
        return None
    return Calibration(
        rig=rig.name,
        reference=rig.arms[rig.recording_order[0]].name,
        cameras=cameras,
        arms=arms,
        wrist_cameras=tuple(
            _calibrated_wrist_camera(rig, one.fit) for one in wrists if one.fit and one.refusal is None
        ),
    )


def _model_and_pose(model: CameraModel, T: Array, interval: PoseInterval, k1_95: float | None) -> dict[str, Any]:
    """Return the keys that fixed and wrist cameras share: the lens, the pose (4, 4) and their intervals."""
    lens = {"width": model.width, "height": model.height, "K": model.K, "distortion": model.distortion}
    lens["k1_95"] = None if k1_95 is None else round(k1_95, 6)
    return {"position": _numbers(T[:3, 3]), "quat": _quat(T), **lens, **_widths(interval)}


def _calibrated_wrist_camera(rig: RigConfig, fit: WristFit) -> CalibratedWristCamera:
    return CalibratedWristCamera(
        name=fit.name,
        arm=rig.arms[fit.arm].name,
        **_model_and_pose(fit.model, fit.T_cam_in_flange, fit.interval, fit.k1_95),
        pictures=fit.pictures,
        outline_px=fit.outline_px,
    )


def _calibrated_camera(
    outcome: CameraOutcome, number: int, fit: StationFit, intervals: StationIntervals
) -> CalibratedCamera:
    T, start, log_focal = invert_pose(fit.state.T_base_in_cam[number]), outcome.start, fit.state.log_focal[number]
    # The pose belongs to the fitted focal length, also where the fit moved a given one within its error.
    model = start.fitted_model(fit.state.lenses[number], log_focal)
    k1_95 = None if start.is_lens_known else float(intervals.lenses[number])
    focal_95 = max(Z95 * model.focal_sigma, abs(log_focal)) if start.is_focal_known else intervals.log_focal[number]
    return CalibratedCamera(
        name=outcome.name,
        **_model_and_pose(model, T, intervals.cameras[number], k1_95),
        focal="given" if start.is_focal_known else "estimated",
        focal_95_percent=100 * focal_95,
        delay_ms=1000 * fit.state.delays[number],
        delay_95_ms=1000 * intervals.delays[number],
        frames=int(outcome.figures["frames"]),
        outline_px=outline_px(fit, number),
    )


def _calibrated_arm(name: str, number: int, fit: StationFit, intervals: StationIntervals) -> CalibratedArm:
    T, found, found_widths = fit.state.T_arm_in_base[number], fit.state.offsets[number], intervals.offsets[number]
    prior = FitPriors().offset
    # In the base that is written, the measured first joint is true.
    offsets, widths = (np.concatenate([[0.0], values[1:]]) for values in (found, found_widths))
    return CalibratedArm(
        name=name,
        position=_numbers(T[:3, 3]),
        quat=_quat(T),
        **_widths(intervals.bases[number]),
        joint_offsets_deg=tuple(float(value) for value in np.degrees(offsets).round(4)),
        joint_offsets_95_deg=tuple(float(value) for value in np.degrees(widths).round(4)),
        joint_offsets_estimated=(False, *(is_measured(float(width), prior) for width in widths[1:])),
        base_body_turn_deg=float(np.degrees(found[0]).round(4)),
        base_body_turn_95_deg=float(np.degrees(found_widths[0]).round(4)),
    )


def _assumed_arm(rig: RigConfig, number: int) -> CalibratedArm:
    """Return an arm as the rig has it, with the intervals before the fit."""
    priors, dof = FitPriors(), rig.arms[number].robot.dof
    T = rig_bases(rig)[number]
    is_reference = number == rig.recording_order[0]
    shift, turn = (0.0, 0.0) if is_reference else (priors.base_shift, priors.base_turn)
    interval = PoseInterval(np.full(3, Z95 * shift), np.full(3, Z95 * turn))
    width = Z95 * math.degrees(priors.offset)
    return CalibratedArm(
        name=rig.arms[number].name,
        position=_numbers(T[:3, 3]),
        quat=_quat(T),
        **_widths(interval),
        joint_offsets_deg=(0.0,) * dof,
        joint_offsets_95_deg=(0.0, *(width,) * (dof - 1)),
        joint_offsets_estimated=(False,) * dof,
        base_body_turn_deg=0.0,
        base_body_turn_95_deg=width,
    )


def make_report(
    rig: RigConfig,
    outcome: StationOutcome,
    calibration: Calibration | None,
    moves: Sequence[WristCameraMoves],
    wrists: Sequence[WristOutcome] = (),
) -> dict[str, Any]:
    """Return the JSON report: the calibration, the refusal or figures of each camera, and the wrist cameras' arms."""
    arms = [arm.name for arm in rig.arms]
    are_arms_exchanged = any(EXCHANGED_OVERLAP in one.figures for one in outcome.cameras)
    return {
        "rig": rig.name,
        "episodes": [one.name for one in outcome.episodes],
        "cameras": [
            {
                "name": one.name,
                "status": "ok" if one.refusal is None else "refused",
                "reason": one.refusal,
                **_pose_figures(calibration, one.name),
                **one.figures,
            }
            for one in outcome.cameras
        ],
        "wrist_cameras": [
            {
                "name": one.name,
                "status": "ok" if one.refusal is None else "refused",
                "reason": one.refusal,
                "T_cam_in_flange": one.fit.T_cam_in_flange.tolist() if one.fit and one.refusal is None else None,
                "pictures": one.fit.pictures if one.fit else 0,
                "openings": one.fit.openings if one.fit else 0,
                "found_share": one.fit.found_share if one.fit else 0.0,
            }
            for one in wrists
        ],
        "wrist_camera_moves": [
            {"name": one.name, "correlations": dict(zip(arms, one.correlations.tolist(), strict=True))} for one in moves
        ],
        "wrist_cameras_fault": wrist_camera_fault(moves, arms, are_arms_exchanged=are_arms_exchanged),
        "joint_offsets_rad": {arm.name: arm.offsets.tolist() for arm in calibration.arms} if calibration else {},
        "frames": frame_residuals(outcome),
        "calibration": calibration.model_dump(mode="json") if calibration else None,
    }


def _pose_figures(calibration: Calibration | None, name: str) -> dict[str, Any]:
    """Return pose, largest standard deviations (m, rad) and delay (s) of a camera; null if it was refused."""
    for camera in calibration.cameras if calibration else ():
        if camera.name == name:
            return {
                "T_cam_in_base": camera.T_cam_in_base.tolist(),
                "sigma_m": max(camera.position_95_mm) / Z95 / 1000,
                "sigma_rad": math.radians(max(camera.rotation_95_deg)) / Z95,
                "delay_s": camera.delay_ms / 1000,
            }
    return {"T_cam_in_base": None, "sigma_m": None, "sigma_rad": None, "delay_s": None}


def frame_residuals(outcome: StationOutcome) -> list[dict[str, Any]]:
    """Return, for each picture of the fit, its median distance of outlines to edges (px) and share of found edges."""
    if outcome.fit is None:
        return []
    rows = []
    for one in outcome.fit.equations:
        frame = outcome.views[one.camera].frames[one.frame]
        rows.append(
            {
                "camera": outcome.fitted[one.camera],
                "episode": outcome.episodes[frame.episode].name,
                "picture": frame.picture,
                "time_s": frame.time,
                "outline_px": one.median if math.isfinite(one.median) else None,
                "found_share": one.found / max(one.points, 1),
            }
        )
    return rows


def raise_for_refusals(outcome: StationOutcome, wrists: Sequence[WristOutcome] = ()) -> None:
    """Raise DatasetError if no camera has a certain pose, and PartialJobError if some have none."""
    every: list[CameraOutcome | WristOutcome] = [*outcome.cameras, *wrists]
    refused = [one for one in every if one.refusal is not None]
    if not refused:
        return
    text = "; ".join(f"camera {one.name!r}: {one.refusal}" for one in refused)
    if len(refused) == len(every):
        raise DatasetError(text)
    raise PartialJobError(f"{text}; the other cameras are calibrated")


def require_agreement(given: Calibration, found: Calibration) -> list[dict[str, Any]]:
    """Return the differences of two calibrations by camera.

    Raises:
        SimulationError: a camera's poses differ by more than both intervals.
    """
    rows, faults = [], []
    for camera in given.cameras:
        ours = next((one for one in found.cameras if one.name == camera.name), None)
        if ours is None:
            continue
        a, b = camera.T_cam_in_base, ours.T_cam_in_base
        shift = 1000 * (a[:3, 3] - b[:3, 3])
        turn = np.degrees(rotation_vector(a[:3, :3] @ b[:3, :3].T))
        shift_limit = np.add(camera.position_95_mm, ours.position_95_mm)
        turn_limit = np.add(camera.rotation_95_deg, ours.rotation_95_deg)
        agrees = bool((np.abs(shift) <= shift_limit).all() and (np.abs(turn) <= turn_limit).all())
        mm, degrees = float(np.linalg.norm(shift)), float(np.linalg.norm(turn))
        rows.append({"name": camera.name, "agrees": agrees, "shift_mm": mm, "turn_deg": degrees})
        if not agrees:
            faults.append(f"camera {camera.name!r} is {mm:.1f} mm and {degrees:.2f} degrees away")
    if faults:
        raise SimulationError(
            f"the pictures contradict the calibration: {'; '.join(faults)}, more than the intervals of both; was a "
            "camera or a base moved?"
        )
    return rows


def write_page(
    rig: RigConfig, outcome: StationOutcome, calibration: Calibration | None, wrists: Sequence[WristOutcome] = ()
) -> str:
    """Return the page: poses with intervals, refusals, and the arms over the pictures."""
    body: list[Markup | None] = [
        html_tag("p", f"from {len(outcome.episodes)} episodes", class_="where"),
        _refusals_section([*outcome.cameras, *wrists]),
    ]
    if calibration:
        body += [_cameras_section(calibration), _wrist_cameras_section(calibration), _arms_section(calibration)]
    for number, name in enumerate(outcome.fitted):
        figures = _picture_figures(outcome, number)
        body.append(grid_section(f"Camera {name}: the arms at their estimated places", figures, "columns"))
    title = f"Cameras and arms of {rig.name}"
    return html_page("Calibration", "Calibration of a station", title, [one for one in body if one], page_footer())


def _refusals_section(cameras: Sequence[CameraOutcome | WristOutcome]) -> Markup | None:
    items = [html_tag("li", f"{one.name}: {one.refusal}") for one in cameras if one.refusal is not None]
    return html_section("Refused cameras", html_tag("ul", items)) if items else None


def _cameras_section(calibration: Calibration) -> Markup | None:
    cells = [
        [
            one.name,
            *_pose_cells(one),
            _with_interval(one.K[0][0], one.K[0][0] * one.focal_95_percent / 100, 1),
            _with_interval(one.delay_ms, one.delay_95_ms, 0),
            f"{one.outline_px:.2f}",
            _k1_cell(one),
            str(one.frames),
        ]
        for one in calibration.cameras
    ]
    place = f"position in the base of {calibration.reference}, mm"
    heads = ("camera", place, "turn, degrees", "focal length, px", "delay, ms", "outline, px", _K1_HEAD, "pictures")
    return html_section("Fixed cameras", html_tag("p", _FIGURES_TEXT), html_table(heads, cells)) if cells else None


def _wrist_cameras_section(calibration: Calibration) -> Markup | None:
    cells = [
        [
            one.name,
            one.arm,
            *_pose_cells(one),
            f"{one.K[0][0]:.1f}",
            f"{one.outline_px:.2f}",
            _k1_cell(one),
            str(one.pictures),
        ]
        for one in calibration.wrist_cameras
    ]
    heads = (
        "camera",
        "arm",
        "position on the flange, mm",
        "turn, degrees",
        "focal length, px",
        "outline, px",
        _K1_HEAD,
        "pictures",
    )
    return html_section("Wrist cameras", html_table(heads, cells)) if cells else None


def _k1_cell(camera: CalibratedCamera | CalibratedWristCamera) -> str:
    return _UNKNOWN if camera.k1_95 is None else _with_interval(camera.distortion[0], camera.k1_95, 3)


def _arms_section(calibration: Calibration) -> Markup:
    cells = []
    for arm in calibration.arms:
        rows = zip(arm.joint_offsets_deg, arm.joint_offsets_95_deg, arm.joint_offsets_estimated, strict=True)
        offsets = [_with_interval(value, width, 2) if estimated else _UNKNOWN for value, width, estimated in rows]
        is_reference = arm.name == calibration.reference
        base = ["the reference", ""] if is_reference else _pose_cells(arm)
        cells.append([arm.name, *base, _body_turn_text(arm) or _UNKNOWN, *offsets[1:]])
    joints = [f"joint {number}" for number in range(2, max(len(row) for row in cells) - 2)]
    place = f"position of the base in the base of {calibration.reference}, mm"
    heads = ("arm", place, "turn, degrees", "turn of the base body, degrees", *joints)
    text = (
        "Joint offsets, in degrees, are measured minus true joints. The offset of joint 1 is 0 by definition. It "
        "appears as the turn of the base body about z, relative to the base's frame. "
        f"The pictures do not determine values marked {_UNKNOWN}."
    )
    return html_section("Arms", html_tag("p", text), html_table(heads, cells))


def _body_turn_text(arm: CalibratedArm) -> str | None:
    """Return the turn of an arm's base body with its interval, degrees; None if the pictures do not determine it."""
    width = arm.base_body_turn_95_deg
    if width is None or not is_measured(math.radians(width), FitPriors().offset):
        return None
    return _with_interval(arm.base_body_turn_deg, width, 2)


def _pose_cells(body: CalibratedCamera | CalibratedWristCamera | CalibratedArm) -> list[str]:
    """Return the position, mm, and the interval of the turn, degrees."""
    values = zip(body.position, body.position_95_mm, strict=True)
    place = ", ".join(_with_interval(1000 * value, width, 1) for value, width in values)
    return [place, f"\N{PLUS-MINUS SIGN}\N{NO-BREAK SPACE}{max(body.rotation_95_deg):.2f}"]


def _with_interval(value: float, width: float, digits: int) -> str:
    # A narrow column breaks before the sign, and not within a number.
    return f"{value:.{digits}f} \N{PLUS-MINUS SIGN}\N{NO-BREAK SPACE}{width:.{digits}f}"


def _picture_figures(outcome: StationOutcome, number: int) -> list[Markup]:
    assert outcome.fit is not None  # a fitted camera has a fit
    view = outcome.views[number]
    residuals = {one.frame: one for one in outcome.fit.equations if one.camera == number}
    count = min(_SHOWN_FRAMES, len(view.frames))
    figures = []
    for k in np.linspace(0, len(view.frames) - 1, count).round().astype(int).tolist():
        view.set_state(outcome.fit.state, number, outcome.episodes, k)
        arms, frame = view.renderer.arm_picture(), view.frames[k]
        picture = blend_arms(frame.image, arms.colour, arms.labels, _OPACITY)
        name = Path(outcome.episodes[frame.episode].name).name
        caption = f"{name}, {frame.time:.2f} s: outline {residuals[k].median:.2f} px from the picture's edges"
        figures.append(captioned_jpeg(caption, encode_jpeg(picture, _JPEG_QUALITY), _PAGE_PX))
    return figures


def wrist_lines(wrists: Sequence[WristOutcome]) -> list[str]:
    """Return a line for each wrist camera."""
    lines = []
    for one in wrists:
        if one.fit is None or one.refusal is not None:
            lines.append(f"{one.name}: refused: {one.refusal}")
            continue
        x, y, z = (f"{value:.4f}" for value in one.fit.T_cam_in_flange[:3, 3])
        shift, turn = 1000 * one.fit.interval.position.max(), math.degrees(one.fit.interval.turn.max())
        lines.append(
            f"{one.name}: ok, on the flange at ({x}, {y}, {z}) m within {shift:.1f} mm and {turn:.2f} degrees (95 %), "
            f"outline {one.fit.outline_px:.2f} px, {one.fit.pictures} pictures"
        )
    return lines


def result_lines(outcome: StationOutcome, calibration: Calibration | None) -> list[str]:
    """Return a line for each camera and arm."""
    by_name = {one.name: one for one in calibration.cameras} if calibration else {}
    lines = []
    for one in outcome.cameras:
        if one.refusal is not None:
            lines.append(f"{one.name}: refused: {one.refusal}")
            continue
        camera = by_name[one.name]
        x, y, z = (f"{value:.4f}" for value in camera.position)
        lines.append(
            f"{one.name}: ok, at ({x}, {y}, {z}) m within {max(camera.position_95_mm):.1f} mm and "
            f"{max(camera.rotation_95_deg):.2f} degrees (95 %), outline {camera.outline_px:.2f} px, "
            f"{camera.frames} pictures"
        )
    for arm in calibration.arms if calibration else ():
        lines.append(f"{arm.name}: {_offset_text(arm)}")
    return lines


def _offset_text(arm: CalibratedArm) -> str:
    estimated = [
        f"joint{k} {value:.2f}"
        for k, (value, known) in enumerate(
            zip(arm.joint_offsets_deg, arm.joint_offsets_estimated, strict=True), start=1
        )
        if known
    ]
    held = [f"joint{k}" for k, known in enumerate(arm.joint_offsets_estimated[1:], start=2) if not known]
    text = (
        f"joint offsets {', '.join(estimated)} degrees"
        if estimated
        else "no joint offset is estimated from the pictures"
    )
    if held:
        text += f"; held: {', '.join(held)}"
    turn = _body_turn_text(arm)
    return f"{text}; base body turned by {turn} degrees (95 %), an offset of joint1" if turn else text


def output_files(folder: Path) -> Sequence[Path]:
    """Return the files that a calibration writes."""
    return [folder / name for name in (CALIBRATION_FILE, REPORT_FILE, PAGE_FILE)]


def write_results(
    folder: Path, report: Mapping[str, Any], page: str, calibration: Calibration | None
) -> Sequence[Path]:
    """Write the files of a calibration, and return them, the page last.

    Without a calibration, an earlier `calibration.yaml` in the folder is removed: it does not belong to this report.

    Raises:
        ResourceError: the folder cannot be written.
    """
    yaml_file, report_file, page_file = output_files(folder)
    files = {report_file: json_text(report).encode(), page_file: page.encode()}
    if calibration is not None:
        files = {yaml_file: calibration_text(calibration).encode(), **files}
    write_outputs(files, make_folder=True)
    if calibration is None:
        yaml_file.unlink(missing_ok=True)
    return list(files)
