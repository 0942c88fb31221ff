"""Compare simulated arms with photos: outlines with edges, and masks with masks of the measured joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.attempt_data import ArmPosture
from ..core.config.rendering import RenderConfig
from ..core.config.rig import RigConfig
from ..core.config.scene import SceneConfig
from ..core.dataset.dataset_paths import image_path, lowdim_path
from ..core.dataset.lowdim import load_frame
from ..core.errors import ResourceError, UsageError, suggest_similar
from ..core.files.resources import Locations
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import invert_pose
from ..core.images.image import Image
from ..core.images.image_files import read_image, to_grey
from ..core.images.jpeg import encode_jpeg
from ..core.progress import Progress
from ..core.recorded_motion import RecordedMotion
from ..photos.overlay.joint_files import ArmPostures
from ..photos.overlay.outline_fit import mask_iou, score_outlines
from ..photos.overlay.photo_arm_poses import find_arms
from ..photos.overlay.photo_cameras import PhotoCameras
from ..photos.overlay.photos import Photo, PlacedCamera, camera_matrix, choose_camera, frame_errors, pinhole_camera
from ..photos.overlay.rendered_arms import ArmRenderers
from ..photos.picture_overlay import blend_arms, write_lines
from ..real.gap.gap_figures import MotionGap
from ..real.gap.gap_page import CaptionedJpeg


@dataclass(frozen=True)
class RecordedPhoto:
    """A photo from a recording of a real arm.

    Attributes:
        frame: number of the photo, from 0; only samples with measured joints count.
        sample: index of the same time in `gap.motion`, where all samples count.
    """

    gap: MotionGap
    frame: int
    sample: int
    path: Path


def photos_in_parts(gaps: Sequence[MotionGap], camera: str | None) -> tuple[str, list[RecordedPhoto]]:
    """Return a camera's name, by default the first that is no wrist camera, and its photos at compared times."""
    folders = {gap.name: Path(gap.name) for gap in gaps if (Path(gap.name) / "rgb").is_dir()}
    cameras = sorted({path.name for folder in folders.values() for path in (folder / "rgb").iterdir() if path.is_dir()})
    if not cameras:
        raise UsageError("--pictures: no recording has photos; leave it out, or give episodes with rgb/")
    camera = choose_camera(cameras, camera)
    if camera not in cameras:
        raise UsageError(f"--episode-camera {camera!r}: no recording has it; {suggest_similar(camera, cameras)}")
    taken = []
    for gap in gaps:
        known = _known_joints(gap.motion)
        for frame, sample in enumerate(np.flatnonzero(known).tolist()):
            if gap.name in folders and gap.is_compared[sample]:
                path = folders[gap.name] / image_path(camera, frame)
                if path.is_file():
                    taken.append(RecordedPhoto(gap, frame, sample, path))
    if not taken:
        raise UsageError(
            f"--pictures: camera {camera!r} has no photo of the compared time; choose another --from, --to"
        )
    return camera, taken


def select_photos(taken: Sequence[RecordedPhoto], maximum: int) -> list[RecordedPhoto]:
    """Return at most `maximum` evenly spaced photos, and that with the largest simulated joint error."""
    if len(taken) <= maximum:
        return list(taken)
    worst = max(range(len(taken)), key=lambda k: _largest_joint_error(taken[k]))
    even = np.linspace(0, len(taken) - 1, maximum - 1).round().astype(int).tolist() if maximum > 1 else []
    return [taken[k] for k in sorted({worst, *even})]


def _largest_joint_error(photo: RecordedPhoto) -> float:
    both = zip(photo.gap.motion.arms, photo.gap.simulated.arms, strict=True)
    return max(float(np.abs(real.joints[photo.sample] - made.joints[photo.sample]).max()) for real, made in both)


def _known_joints(motion: RecordedMotion) -> NDArray[np.bool_]:
    """Return a flag (samples,): whether all joints are known."""
    known: NDArray[np.bool_] = np.logical_and.reduce([np.isfinite(arm.joints).all(axis=1) for arm in motion.arms])
    return known


def _known_joints_before(motion: RecordedMotion, delay: float) -> NDArray[np.bool_]:
    """Return a flag (samples,): whether the joints on both sides of the time `delay`, s, before a sample are known."""
    seen = motion.times - delay
    after = np.searchsorted(motion.times, seen).clip(max=len(seen) - 1)
    known = _known_joints(motion)
    within = (motion.times[0] <= seen) & (seen <= motion.times[-1])
    flags: NDArray[np.bool_] = within & known[after] & known[np.maximum(after - 1, 0)]
    return flags


def calibrated_postures(motion: RecordedMotion, sample: int, rig: RigConfig, placed: PlacedCamera) -> ArmPostures:
    """Return what a photo that is stamped with the time of a sample (index) shows, by the calibration's delay.

    Joints are without the calibration's offsets, which replace the offsets of the rig's revision.
    """
    known = _known_joints(motion)
    times, seen = motion.times[known], motion.times[sample] - placed.delay
    postures = {}
    for arm, number in zip(motion.arms, rig.recording_order, strict=True):
        joints = np.array([np.interp(seen, times, column) for column in arm.joints[known].T])
        opening = 0.0 if arm.openings is None else float(np.interp(seen, times, np.nan_to_num(arm.openings[known])))
        postures[number] = ArmPosture(joints, opening)
    return placed.true_postures(tuple(postures[number] for number in range(len(rig.arms))))


def postures_at(motion: RecordedMotion, sample: int, rig: RigConfig) -> ArmPostures:
    """Return joints and gripper opening of each arm at a sample (index) of a motion."""
    postures = {}
    for arm, number in zip(motion.arms, rig.recording_order, strict=True):
        config, opening = rig.arms[number], 0.0 if arm.openings is None else float(np.nan_to_num(arm.openings[sample]))
        dynamics, names = config.dynamics, config.robot.joint_names
        # Recorded joints include the encoder offsets, and the model's joints do not.
        off = [0.0 if dynamics is None else dynamics.joint(name).offset_rad for name in names]
        postures[number] = ArmPosture(arm.joints[sample] - off, opening)
    return tuple(postures[number] for number in range(len(rig.arms)))


def make_photo(recorded: RecordedPhoto, camera: str, rig: RigConfig, image: Image) -> Photo:
    """Return a photo with the simulated postures, and with camera and pose if the frame holds them."""
    file = Path(recorded.gap.name) / lowdim_path(recorded.frame)
    with frame_errors(file):
        frame = load_frame(file.read_bytes())
        K, T_cam_in_base = (
            None if (frame.get(key) or {}).get(camera) is None else camera_matrix(frame, key, camera)
            for key in ("intrinsics", "extrinsics")
        )
    height, width = image.shape[:2]
    T_base_in_cam = None
    if T_cam_in_base is not None:
        # Recorded extrinsics are relative to the base of the only or left arm.
        T_cam_in_world = rig.T_base_in_world(rig.recording_order[0]) @ T_cam_in_base
        T_base_in_cam = invert_pose(T_cam_in_world) @ rig.T_base_in_world(0)
    model = None if K is None else pinhole_camera(K, width, height)
    return Photo(
        recorded.path, model, postures_at(recorded.gap.simulated, recorded.sample, rig), "episode", T_base_in_cam
    )


_MAX_SHOWN_PHOTOS = 2  # with the largest errors
_OPACITY = 0.4  # of the simulated arms over a photo, 0..1
_JPEG_QUALITY = 85  # 0..100


@dataclass(frozen=True)
class PhotoRequest:
    """The photos of recordings to compare.

    Attributes:
        camera: calibration of all photos; None for the recorded intrinsics, or else an estimate from ArUco boards.
        name: of the camera; None for the first that is no wrist camera.
        placed: the calibration of the camera and the arms, which replaces `camera`, boards and recorded poses.
    """

    max_photos: int
    camera: CameraModel | None = None
    name: str | None = None
    placed: PlacedCamera | None = None


@dataclass(frozen=True)
class PhotoGap:
    """Comparison of the simulated arms with a photo.

    Attributes:
        outline_distance: median distance of the simulated outline to the photo's edges, px; None if no arm is visible.
        measured_outline_distance: the same for arms at the measured joints: the distance if simulation were exact.
        iou: intersection over union of the arms' masks at simulated and at measured joints, 0..1.
    """

    recorded: RecordedPhoto
    outline_distance: float | None
    measured_outline_distance: float | None
    iou: float
    picture: Image


def compare_photos(
    gaps: Sequence[MotionGap],
    rig: RigConfig,
    request: PhotoRequest,
    scene: SceneConfig,
    quality: RenderConfig,
    locations: Locations,
    progress: Progress,
) -> tuple[dict[str, Any], list[CaptionedJpeg]]:
    """Compare simulated arms with recorded photos. Return JSON data, and the worst photos as pictures."""
    camera, taken = photos_in_parts(gaps, request.name)
    if request.placed is not None:
        delay = request.placed.delay
        is_known = {gap.name: _known_joints_before(gap.motion, delay) for gap in gaps}
        taken = [photo for photo in taken if is_known[photo.gap.name][photo.sample]]
        if not taken:
            raise UsageError(f"--calibration: no joints are known {1000 * delay:.0f} ms before any photo, its delay")
    chosen = select_photos(taken, request.max_photos)
    found: list[PhotoGap] = []
    figures: list[PhotoGap] = []
    lenses = PhotoCameras(rig, [one.path for one in chosen], request.camera)
    with ArmRenderers(rig, scene, quality, locations) as renderers:
        for k, one in enumerate(chosen):
            progress(k, len(chosen))
            if compared := _compare_photo(one, camera, rig, request.placed, lenses, renderers):
                figures.append(compared)
                found = sorted([*found, compared], key=_error_rank, reverse=True)[:_MAX_SHOWN_PHOTOS]
        progress(len(chosen), len(chosen))
    if not figures:
        raise ResourceError(
            f"no photo of camera {camera!r} gives its pose, first {chosen[0].path}: its frames have no extrinsics, "
            "and no board is in sight; give recordings with extrinsics, or leave --pictures out"
        )
    return _camera_report(camera, figures, len(chosen) - len(figures)), [_captioned_photo(one) for one in found]


def _compare_photo(
    recorded: RecordedPhoto,
    camera: str,
    rig: RigConfig,
    placed: PlacedCamera | None,
    lenses: PhotoCameras,
    renderers: ArmRenderers,
) -> PhotoGap | None:
    """Compare one photo; None if neither a calibration, nor its frame, nor a board gives the camera's pose."""
    image = read_image(recorded.path)
    postures_of = postures_at if placed is None else partial(calibrated_postures, placed=placed)
    if placed is None:
        photo = make_photo(recorded, camera, rig, image)
    else:
        shown = postures_of(recorded.gap.simulated, recorded.sample, rig)
        photo = Photo(recorded.path, placed.camera, shown, "episode", placed=placed)
    lens, grey = lenses.camera_of(photo, image), to_grey(image)
    result = find_arms(rig, photo, grey, lens, trust_margin=False)
    if not result.base_poses:
        return None
    renderer = renderers.renderer_for(lens.camera)
    renderer.set_poses(result.base_poses, postures_of(recorded.gap.motion, recorded.sample, rig))
    measured, measured_mask = score_outlines(result, renderer, grey), renderer.undistorted_label_image() > 0
    renderer.set_poses(result.base_poses, postures_of(recorded.gap.simulated, recorded.sample, rig))
    simulated, iou = (
        score_outlines(result, renderer, grey),
        mask_iou(renderer.undistorted_label_image() > 0, measured_mask),
    )
    arms = renderer.render()
    picture = blend_arms(image, arms.colour, arms.labels, _OPACITY)
    lines = [f"simulated, {recorded.gap.motion.times[recorded.sample]:.2f} s, frame {recorded.frame}"]
    if simulated.edge_residual is not None:
        lines.append(f"outline {simulated.edge_residual:.1f} px, overlap {iou:.3f}")
    write_lines(picture, lines, arms.labels > 0)
    return PhotoGap(recorded, simulated.edge_residual, measured.edge_residual, iou, picture)


def _error_rank(found: PhotoGap) -> tuple[float, float]:
    return -1.0 if found.outline_distance is None else found.outline_distance, 1 - found.iou


def _camera_report(camera: str, figures: Sequence[PhotoGap], without: int) -> dict[str, Any]:
    worst = max(figures, key=_error_rank)
    return {
        "camera": camera,
        "photos": len(figures),
        "without_pose": without,
        "outline_px": _mean_and_worst([one.outline_distance for one in figures], max),
        "measured_outline_px": _mean_and_worst([one.measured_outline_distance for one in figures], max),
        "iou": _mean_and_worst([one.iou for one in figures], min),
        "worst": _photo_reference(worst),
        "frames": [
            {
                **_photo_reference(one),
                "image": str(one.recorded.path),
                "outline_px": one.outline_distance,
                "measured_outline_px": one.measured_outline_distance,
                "iou": one.iou,
            }
            for one in figures
        ],
    }


def _photo_reference(found: PhotoGap) -> dict[str, Any]:
    recorded = found.recorded
    time = float(recorded.gap.motion.times[recorded.sample])
    return {"recording": recorded.gap.name, "frame": recorded.frame, "time_s": time}


def _mean_and_worst(values: Sequence[float | None], worst: Any) -> dict[str, float] | None:
    known = [value for value in values if value is not None]
    return {"mean": float(np.mean(known)), "worst": float(worst(known))} if known else None


def _captioned_photo(found: PhotoGap) -> CaptionedJpeg:
    place = _photo_reference(found)
    outline = (
        "no arm in sight"
        if found.outline_distance is None
        else f"outline {found.outline_distance:.1f} px from the photo's edges"
    )
    caption = (
        f"Frame {place['frame']} of {place['recording']} at {place['time_s']:.2f} s: the simulated arm over the photo; "
        f"{outline}, overlap {found.iou:.3f}."
    )
    return CaptionedJpeg(caption, encode_jpeg(found.picture, _JPEG_QUALITY))
