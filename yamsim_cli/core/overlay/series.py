"""All photos of one call: what is known of each, one overlay after the other, files, video, and what does not pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from ..config.recording import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError, ResourceError, UsageError
from ..geometry.camera import CameraModel
from ..geometry.se3 import Array
from ..images.image import Image
from ..images.image_files import read_image, read_mask
from ..images.video import VideoWriter
from ..resources import Locations
from ..scene.compose import Meshes
from ..vision.fiducials.locate import Status
from .arm_poses import Lens, unknown_lens
from .overlayer import Overlay, Overlayer, OverlayOptions, picture_paths, write_overlay
from .photos import Photo, mask_of
from .report import OverlayReport

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class OverlayRequest:
    """What to do with which photos.

    Attributes:
        photos: in order.
        camera: that took those which do not know their own; None estimates it from the boards.
        joints: of every arm (rows, arms, 7), one row for all photos or a row for each; None for what each photo knows.
        out: folder for the pictures and the report.
        write_masks: also write each photo's segmentation: 0 for none, k for the k-th arm.
        mask_images: the user's own mask of the photos, or a folder with masks of the photos' names.
        video, frame_period: an MP4 of all pictures, and the seconds from one to the next; an older one is moved aside.
        max_reprojection, min_iou: what each photo has to reach, px and 0..1.
    """

    photos: Sequence[Photo]
    options: OverlayOptions
    camera: CameraModel | None = None
    joints: Array | None = None
    out: Path = Path("overlays")
    write_masks: bool = False
    mask_images: Path | None = None
    video: Path | None = None
    frame_period: float = 1 / 15
    max_reprojection: float | None = None
    min_iou: float | None = None


def run_overlays(
    rig: RigConfig,
    request: OverlayRequest,
    scene: SceneConfig,
    quality: RenderConfig,
    locations: Locations,
    meshes: Meshes,
    progress: Progress,
) -> OverlayReport:
    """Lay the rig over every photo that can be read.

    Raises:
        ConfigError: joints, masks or camera do not fit the photos.
        UsageError: an output would replace an input, or photos of several sizes are to make one video.
        ResourceError: no photo can be read, a mask cannot, or the output cannot be written.
    """
    photos = _with_joints(request)
    stems = _stems(photos)
    masks = [None if request.mask_images is None else mask_of(request.mask_images, photo.path) for photo in photos]
    _refuse_overwriting(request, stems, [photo.path for photo in photos] + [path for path in masks if path])
    try:
        request.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(f"{request.out} cannot be made: {error.strerror}; choose another --out") from error
    report = OverlayReport(rig)
    cameras = _Cameras(rig, request)
    with ExitStack() as stack:
        overlayer = stack.enter_context(Overlayer(rig, request.options, scene, quality, locations, meshes))
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
    if request.video:
        report.files.append(request.video)
    report.write(request.out)
    return report


def _with_joints(request: OverlayRequest) -> list[Photo]:
    """The photos, each with its row of the request's joints."""
    rows, photos = request.joints, request.photos
    if rows is None:
        return list(photos)
    if len(rows) not in (1, len(photos)):
        raise ConfigError(f"--joints has {len(rows)} rows for {len(photos)} photos; give one row, or one for each")
    return [
        replace(photo, joints=rows[k if len(rows) > 1 else 0], joints_source="file") for k, photo in enumerate(photos)
    ]


class _Cameras:
    """Whose photos they are: each photo's own camera, the user's, or one estimated from all photos of a size."""

    def __init__(self, rig: RigConfig, request: OverlayRequest) -> None:
        self._rig = rig
        self._request = request
        self._estimated: dict[tuple[int, int], Lens] = {}

    def of(self, photo: Photo, image: Image) -> Lens:
        """The camera of a photo, and where its figures come from."""
        if photo.camera:
            return Lens.known(photo.camera, "episode")
        if self._request.camera:
            return Lens.known(self._request.camera, "file")
        size = image.shape[0], image.shape[1]
        if size not in self._estimated:
            self._estimated[size] = unknown_lens(self._images(photo, image), size, self._rig)
        return self._estimated[size]

    def _images(self, known: Photo, image: Image) -> Iterator[Image]:
        """One after the other, all photos of the size of one that is known already, if they can be read."""
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


def _refuse_overwriting(request: OverlayRequest, stems: Sequence[str], inputs: Sequence[Path]) -> None:
    taken = {path.resolve() for path in inputs}
    for stem in stems:
        for path in picture_paths(request.out, stem, request.write_masks):
            if path.resolve() in taken:
                raise UsageError(f"{path} is an input and would be overwritten; choose another --out")


def _stems(photos: Sequence[Photo]) -> list[str]:
    """Names for the photos' results: their own, with the ending's or the place in the list where those are equal."""
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
            found.append(f"{result.path}: {arm.name} has no pose: {arm.sighting.reason}")
        elif rms is not None and rms > request.max_reprojection:
            found.append(
                f"{result.path}: {arm.name}'s reprojection of {rms:.2f} px is above {request.max_reprojection:g}: "
                "check the camera file"
            )
    if request.min_iou is not None and (result.iou or 0.0) < request.min_iou:
        found.append(f"{result.path}: overlap {result.iou or 0.0:.3f} with the mask is below {request.min_iou:g}")
    return found
