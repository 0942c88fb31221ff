"""Overlay a rig's arms on photos; write pictures, masks, video and report."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import write_file
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.image_files import Mask, read_image, read_mask, to_grey
from yamsim_cli.core.images.png import encode_png
from yamsim_cli.core.images.video import VideoWriter
from yamsim_cli.core.progress import Progress

from ..fiducials.board_detection import DEFAULT_POSE_LIMITS, BoardStatus, PoseLimits
from ..picture_overlay import blend_arms, draw_board, write_lines
from .joint_files import ArmPostures, home_postures
from .move_detection import describe_move, find_moves
from .outline_fit import mask_iou, refine_poses, score_outlines
from .overlay_report import REPORT_NAME, OverlayReport, photo_captions
from .photo_arm_poses import RigInPhoto, find_arms
from .photo_cameras import PhotoCameras
from .photos import MASK_SUFFIX, OVERLAY_SUFFIX, Photo, find_mask
from .rendered_arms import ArmRenderers


@dataclass(frozen=True)
class PhotoJob:
    """A photo to overlay, the user's robot mask if any, and the paths of the picture and rendered mask."""

    photo: Photo
    mask: Path | None
    outputs: tuple[Path, ...]


@dataclass(frozen=True)
class OverlayRequest:
    """The settings of an overlay run.

    Attributes:
        jobs: from `photo_jobs`.
        out: folder for pictures and report.
        camera: calibration of all photos; None for the recorded camera or an estimate.
        trust_margin: take the rig's relative arm poses as exact, and fit one rig pose.
        refine: move poses until outlines match the photo's edges.
        opacity: of the rendered arms, 0..1.
        output_video: MP4 file to write, with all pictures; an existing file is replaced.
        frame_period: of the output video, s.
        max_reprojection: RMS error of a board's markers, px.
        min_iou: overlap of rendered and given mask, 0..1.
        fail_if_moved: a move of the camera or a base is a failure.
    """

    jobs: Sequence[PhotoJob]
    out: Path
    camera: CameraModel | None = None
    trust_margin: bool = False
    refine: bool = False
    opacity: float = 0.55
    limits: PoseLimits = DEFAULT_POSE_LIMITS
    output_video: Path | None = None
    frame_period: float = 1 / 15
    max_reprojection: float | None = None
    min_iou: float | None = None
    fail_if_moved: bool = False

    @property
    def output_files(self) -> list[Path]:
        """The files that `run_overlays` writes, without the video."""
        return [*(path for job in self.jobs for path in job.outputs), self.out / REPORT_NAME]


def photo_jobs(
    photos: Sequence[Photo],
    out: Path,
    *,
    postures: Sequence[ArmPostures] | None = None,
    write_masks: bool = False,
    mask_images: Path | None = None,
) -> list[PhotoJob]:
    """Return the photos with postures, masks and output paths.

    Args:
        postures: one element for all photos, or one each; None for recorded ones.
        write_masks: 0 background, k the k-th arm.
        mask_images: the robot mask of all photos, or a folder with masks named after them.

    Raises:
        ConfigError: the number of postures does not match the photos.
        UsageError: an output would replace a photo or a mask.
        ResourceError: a photo has no mask in the folder.
    """
    if postures is not None and len(postures) not in (1, len(photos)):
        raise ConfigError(f"--joints has {len(postures)} rows for {len(photos)} photos; give one row, or one for each")
    endings = (OVERLAY_SUFFIX, MASK_SUFFIX) if write_masks else (OVERLAY_SUFFIX,)
    jobs = []
    for k, (photo, stem) in enumerate(zip(photos, _result_names(photos), strict=True)):
        if postures is not None:
            photo = replace(photo, postures=postures[k if len(postures) > 1 else 0], joints_source="file")
        mask = None if mask_images is None else find_mask(mask_images, photo.path)
        jobs.append(PhotoJob(photo, mask, tuple(out / f"{stem}{ending}" for ending in endings)))
    inputs = {path.resolve() for job in jobs for path in (job.photo.path, job.mask) if path}
    for path in (path for job in jobs for path in job.outputs):
        if path.resolve() in inputs:
            raise UsageError(f"{path} is an input and would be overwritten; choose another --out")
    return jobs


def _result_names(photos: Sequence[Photo]) -> list[str]:
    stems = [photo.path.stem for photo in photos]
    if len(set(stems)) < len(stems):
        stems = [photo.path.name.replace(".", "_") for photo in photos]
    if len(set(stems)) < len(stems):
        stems = [f"{k:06d}_{stem}" for k, stem in enumerate(stems)]
    return stems


def run_overlays(
    rig: RigConfig,
    request: OverlayRequest,
    scene: SceneConfig,
    quality: RenderConfig,
    locations: Locations,
    progress: Progress,
) -> OverlayReport:
    """Draw the arms over every readable photo, and write all files.

    Raises:
        ConfigError: a mask or the camera does not match the photos.
        UsageError: a video is requested for photos of several sizes.
        ResourceError: no photo or a mask cannot be read, or output cannot be written.
    """
    jobs = request.jobs
    try:
        request.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(f"{request.out} cannot be made: {error.strerror}; choose another --out") from error
    report = OverlayReport(rig)
    lenses = PhotoCameras(rig, [job.photo.path for job in jobs], request.camera)
    with ExitStack() as stack:
        renderers = stack.enter_context(ArmRenderers(rig, scene, quality, locations))
        video = request.output_video and stack.enter_context(
            VideoWriter(request.output_video, request.frame_period, overwrite=True)
        )
        size: tuple[int, ...] = ()
        found: RigInPhoto | None = None
        for k, job in enumerate(jobs):
            progress(k, len(jobs))
            try:
                image = read_image(job.photo.path)
            except ResourceError as error:
                report.unreadable.append(str(error))
                continue
            size = size or image.shape
            if video and image.shape != size:
                raise UsageError(
                    f"--video needs photos of one size, but {job.photo.path} differs in size from the photos before it"
                )
            lens, grey = lenses.camera_of(job.photo, image), to_grey(image)
            found = find_arms(rig, job.photo, grey, lens, request.trust_margin, found, request.limits)
            result, picture, labels = _overlay_photo(rig, request, job, image, grey, found, renderers)
            report.results.append(result)
            report.files += _write_images(job.outputs, (picture, labels))
            report.failures += _violated_limits(result, request)
            if video:
                video.write(picture)
        if not report.results:
            raise ResourceError(report.unreadable[0])
        progress(len(jobs), len(jobs))
    report.move_report = find_moves(report.results)
    if request.fail_if_moved:
        report.failures += [describe_move(move) for move in report.move_report.moves]
    if request.output_video:
        report.files.append(request.output_video)
    report.write_report(request.out)
    return report


def _overlay_photo(
    rig: RigConfig,
    request: OverlayRequest,
    job: PhotoJob,
    image: Image,
    grey: Image,
    result: RigInPhoto,
    renderers: ArmRenderers,
) -> tuple[RigInPhoto, Image, NDArray[np.uint8]]:
    """Return the scored result, the picture with arms, and labels (height, width): k for the k-th arm."""
    postures, camera = job.photo.postures or home_postures(rig), result.lens.camera
    picture, labels = image.copy(), np.zeros(image.shape[:2], np.uint8)
    if result.base_poses:
        renderer = renderers.renderer_for(camera)
        if request.refine:
            result = refine_poses(result, renderer, postures, grey, request.trust_margin)
        renderer.set_poses(result.base_poses, postures)
        result = score_outlines(result, renderer, grey)
        arms = renderer.render()
        labels = arms.labels
        picture = blend_arms(image, arms.colour, labels, request.opacity)
    for arm in result.arms:
        if arm.detection and arm.detection.T_board_in_cam is not None:
            draw_board(picture, camera, arm.detection.board, arm.detection.T_board_in_cam)
    if job.mask is not None:
        result = replace(result, iou=_mask_overlap(labels, read_mask(job.mask), result.path))
    write_lines(picture, photo_captions(result), _changed_pixels(picture, image))
    return result, picture, labels


def _mask_overlap(labels: NDArray[np.uint8], mask: Mask, path: Path) -> float:
    if mask.shape != labels.shape:
        raise ConfigError(
            f"the mask for {path} has {mask.shape[1]} x {mask.shape[0]} pixels, the photo {labels.shape[1]} x "
            f"{labels.shape[0]}"
        )
    return mask_iou(labels > 0, mask)


def _changed_pixels(picture: Image, image: Image) -> NDArray[np.bool_]:
    # One channel at a time is much faster.
    changed = np.zeros(image.shape[:2], dtype=np.bool_)
    for k in range(3):
        changed |= picture[..., k] != image[..., k]
    return changed


def _write_images(paths: Sequence[Path], images: Sequence[Image]) -> Sequence[Path]:
    try:
        for path, image in zip(paths, images, strict=False):
            write_file(path, encode_png(image))
    except OSError as error:
        out = paths[0].parent
        raise ResourceError(f"{out} cannot be written: {error.strerror or error}; choose another --out") from error
    return paths


def _violated_limits(result: RigInPhoto, request: OverlayRequest) -> list[str]:
    found = []
    for arm in result.arms:
        if request.max_reprojection is None or arm.board is None or not arm.detection:
            continue
        rms = arm.detection.reprojection_rms
        if arm.detection.status is not BoardStatus.OK:
            found.append(f"{result.path}: {arm.name} is not located: {arm.detection.failure_explanation}")
        elif rms is not None and rms > request.max_reprojection:
            found.append(
                f"{result.path}: {arm.name}'s reprojection error of {rms:.2f} px is above "
                f"{request.max_reprojection:g}: check the camera file"
            )
    if request.min_iou is not None and (result.iou or 0.0) < request.min_iou:
        found.append(f"{result.path}: overlap {result.iou or 0.0:.3f} with the mask is below {request.min_iou:g}")
    return found
