"""Lays a rig over a series of photos, and writes pictures, video and report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from ..config.pictures import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError, ResourceError, UsageError
from ..geometry.camera import CameraModel
from ..images.image import Image
from ..images.image_files import read_image, read_mask
from ..images.video import VideoWriter
from ..progress import Progress
from ..resources import Locations
from ..vision.fiducials.sighting import Status
from .arm_poses import Lens, unknown_lens
from .joint_files import Stands
from .moves import Move, Moved, find_moves
from .overlay_report import REPORT_NAME, OverlayReport
from .overlayer import Overlay, Overlayer, OverlayOptions, picture_paths, write_overlay
from .photos import Photo, mask_of


@dataclass(frozen=True)
class OverlayRequest:
    """The photos, and what to do with them.

    Attributes:
        photos: the photos, in order.
        options: what to do with each.
        camera: the camera of photos that do not know their own; None estimates it from the boards.
        stands: how every arm stands, one row for all photos or a row for each; None for those that each photo knows.
        out: folder for the pictures and the report.
        write_masks: whether a mask of each photo is written: 0 where no arm is, k for the k-th arm.
        mask_images: the user's own mask of the photos, or a folder with masks of the photos' names.
        video: an MP4 of all pictures to write; an older one is replaced.
        frame_period: time from one picture to the next in the video, s.
        max_reprojection, min_iou: limits that each photo has to keep, px and 0..1.
        fail_if_moved: whether it counts as a failure that the camera or a base was moved from one photo to the next.
    """

    photos: Sequence[Photo]
    options: OverlayOptions
    camera: CameraModel | None = None
    stands: Sequence[Stands] | None = None
    out: Path = Path("overlays")
    write_masks: bool = False
    mask_images: Path | None = None
    video: Path | None = None
    frame_period: float = 1 / 15
    max_reprojection: float | None = None
    min_iou: float | None = None
    fail_if_moved: bool = False


def run_overlays(
    rig: RigConfig,
    request: OverlayRequest,
    scene: SceneConfig,
    quality: RenderConfig,
    locations: Locations,
    progress: Progress,
) -> OverlayReport:
    """The report on the photos, after the rig was laid over every one that can be read.

    Raises:
        ConfigError: joints, masks or camera do not fit the photos.
        UsageError: an output would replace an input, or photos of several sizes are to make one video.
        ResourceError: no photo can be read, a mask cannot, or the output cannot be written.
    """
    photos = _with_joints(request)
    stems = _stems(photos)
    masks = _masks(request)
    output_files(request)
    try:
        request.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(f"{request.out} cannot be made: {error.strerror}; choose another --out") from error
    report = OverlayReport(rig)
    cameras = _Cameras(rig, request)
    with ExitStack() as stack:
        overlayer = stack.enter_context(Overlayer(rig, request.options, scene, quality, locations))
        video = request.video and stack.enter_context(VideoWriter(request.video, request.frame_period, overwrite=True))
        size: tuple[int, ...] = ()
        for k, photo in enumerate(photos):
            progress(k, len(photos))
            try:
                image = read_image(photo.path)
            except ResourceError as error:
                report.unreadable.append(str(error))
                continue
            size = size or image.shape
            if video and image.shape != size:
                raise UsageError(f"--video needs photos of one size, but {photo.path} has another than those before it")
            lens = cameras.of(photo, image)
            mask_path = masks[k]
            mask = read_mask(mask_path) if mask_path else None
            overlay = overlayer.run(photo, image, lens, mask)
            report.results.append(overlay.result)
            report.files += write_overlay(overlay, stems[k], request.out, request.write_masks)
            report.failures += _failures(overlay, request)
            if video:
                video.write(overlay.picture)
        if not report.results:
            raise ResourceError(report.unreadable[0])
        progress(len(photos), len(photos))
    report.stillness = find_moves(report.results)
    if request.fail_if_moved:
        report.failures += [told(move) for move in report.stillness.moves]
    if request.video:
        report.files.append(request.video)
    report.write(request.out)
    return report


def output_files(request: OverlayRequest) -> list[Path]:
    """Return the pictures, the masks and the report that `run_overlays` writes.

    Raises:
        UsageError: one of them is a photo or a mask that is read.
        ResourceError: a photo has no mask among those that were given.
    """
    files = [path for stem in _stems(request.photos) for path in picture_paths(request.out, stem, request.write_masks)]
    inputs = {path.resolve() for path in (*(photo.path for photo in request.photos), *_masks(request)) if path}
    for path in files:
        if path.resolve() in inputs:
            raise UsageError(f"{path} is an input and would be overwritten; choose another --out")
    return [*files, request.out / REPORT_NAME]


def told(move: Move) -> str:
    """A line on what was moved, by how much, and before which photo."""
    by = (
        f"{move.shift * 1000:.1f} mm (sigma {move.shift_sigma * 1000:.2f}) and "
        f"{math.degrees(move.turn):.2f} degrees (sigma {math.degrees(move.turn_sigma):.3f})"
    )
    who = {
        Moved.CAMERA: "the camera was moved",
        Moved.BASE: f"the base of {move.arm} was moved",
        Moved.EITHER: f"the camera or the base of {move.arm} was moved (one board alone does not tell which)",
        Moved.SEVERAL: f"the base of {move.arm} was moved against the camera, and the others otherwise",
    }[move.what]
    when = f", {move.time:.2f} s" if move.time is not None else ""
    return f"{move.path} (number {move.photo}{when}): before it {who} by {by}"


def _with_joints(request: OverlayRequest) -> list[Photo]:
    """The photos, each with its row of the request's joints."""
    rows, photos = request.stands, request.photos
    if rows is None:
        return list(photos)
    if len(rows) not in (1, len(photos)):
        raise ConfigError(f"--joints has {len(rows)} rows for {len(photos)} photos; give one row, or one for each")
    return [
        replace(photo, stands=rows[k if len(rows) > 1 else 0], joints_source="file") for k, photo in enumerate(photos)
    ]


class _Cameras:
    """The camera of each photo: its own, the user's, or one that is estimated from all photos of the same size."""

    def __init__(self, rig: RigConfig, request: OverlayRequest) -> None:
        self._rig = rig
        self._request = request
        self._estimated: dict[tuple[int, int], Lens] = {}

    def of(self, photo: Photo, image: Image) -> Lens:
        """The lens of a photo."""
        if photo.camera:
            return Lens.known(photo.camera, "episode")
        if self._request.camera:
            return Lens.known(self._request.camera, "file")
        size = image.shape[0], image.shape[1]
        if size not in self._estimated:
            self._estimated[size] = unknown_lens(self._images(photo, image), size, self._rig)
        return self._estimated[size]

    def _images(self, known: Photo, image: Image) -> Iterator[Image]:
        """All photos of the same size as one that was read already, one after the other, as far as they can be read."""
        for photo in self._request.photos:
            if photo.path == known.path:
                yield image
                continue
            try:
                other = read_image(photo.path)
            except ResourceError:
                continue
            if other.shape[:2] == image.shape[:2]:
                yield other


def _masks(request: OverlayRequest) -> list[Path | None]:
    """The user's mask of each photo; None where no masks were given."""
    folder = request.mask_images
    return [None if folder is None else mask_of(folder, photo.path) for photo in request.photos]


def _stems(photos: Sequence[Photo]) -> list[str]:
    """A name for each photo's results: the photo's, with its ending and its place in the list if names are equal."""
    stems = [photo.path.stem for photo in photos]
    if len(set(stems)) < len(stems):
        stems = [photo.path.name.replace(".", "_") for photo in photos]
    if len(set(stems)) < len(stems):
        stems = [f"{k:06d}_{stem}" for k, stem in enumerate(stems)]
    return stems


def _failures(overlay: Overlay, request: OverlayRequest) -> list[str]:
    result, found = overlay.result, []
    for arm in result.arms:
        rms = arm.sighting.reprojection_rms if arm.sighting else None
        if request.max_reprojection is None or arm.board is None or not arm.sighting:
            continue
        if arm.sighting.status is not Status.OK:
            found.append(f"{result.path}: {arm.name} is not located: {arm.sighting.explanation}")
        elif rms is not None and rms > request.max_reprojection:
            found.append(
                f"{result.path}: {arm.name}'s reprojection of {rms:.2f} px is above {request.max_reprojection:g}: "
                "check the camera file"
            )
    if request.min_iou is not None and (result.iou or 0.0) < request.min_iou:
        found.append(f"{result.path}: overlap {result.iou or 0.0:.3f} with the mask is below {request.min_iou:g}")
    return found
