"""All photos of one call: what is known of each, one overlay after the other, files, video, and whether they pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..config.record import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError, PartialJobError, ResourceError
from ..geometry.camera import CameraModel
from ..geometry.se3 import Array
from ..resources import Locations
from ..scene.compose import Meshes
from ..vision.fiducials.locate import Status
from ..vision.video import VideoWriter
from .arm_poses import PhotoResult, unknown_camera
from .overlay import Overlay, Overlayer, OverlayOptions, write_overlay
from .photos import Photo, read_image

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class OverlayRequest:
    """What to do with which photos.

    Attributes:
        photos: in order.
        camera: that took those which do not know their own; None estimates it from the boards.
        joints: of every arm (rows, arms, 7), one row for all photos or a row for each; None for what each photo knows.
        out: folder for the pictures.
        write_masks: also write each photo's segmentation: 0 for none, k for the k-th arm.
        mask_images: the user's own mask of the one photo, or a folder with masks of the photos' names.
        video, frame_period: an MP4 of all pictures, and the seconds from one to the next.
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


@dataclass
class OverlayReport:
    """What came of it: a result for each photo, the files written, and what does not pass."""

    results: list[PhotoResult] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def check(self, rig: RigConfig) -> None:
        """Turn what is missing or does not pass into an error.

        Raises:
            ResourceError: no photo shows a board, or one does not reach what was asked for.
            PartialJobError: some photos gave a pose and some did not.
        """
        without = [result for result in self.results if not result.bases]
        if len(without) == len(self.results):
            raise ResourceError(_nothing_found(without, rig))
        if self.failures:
            more = f" (and {len(self.failures) - 1} more)" if len(self.failures) > 1 else ""
            raise ResourceError(f"{self.failures[0]}{more}")
        if without:
            raise PartialJobError(
                f"{len(without)} of {len(self.results)} photos give no pose, first {_nothing_found(without[:1], rig)}"
            )


def run_overlays(
    rig: RigConfig,
    request: OverlayRequest,
    scene: SceneConfig,
    quality: RenderConfig,
    locations: Locations,
    meshes: Meshes,
    progress: Progress,
) -> OverlayReport:
    """Lay the rig over every photo.

    Raises:
        ConfigError: joints, masks or camera do not fit the photos.
        ResourceError: a photo cannot be read, or the output cannot be written.
    """
    joints = request.joints
    if joints is not None and len(joints) not in (1, len(request.photos)):
        raise ConfigError(
            f"--joints has {len(joints)} rows for {len(request.photos)} photos; give one row, or one for each"
        )
    stems = _stems(request.photos)
    inputs = {photo.path.resolve() for photo in request.photos}
    report = OverlayReport()
    estimated: dict[tuple[int, int], CameraModel] = {}
    with ExitStack() as stack:
        overlayer = stack.enter_context(Overlayer(rig, request.options, scene, quality, locations, meshes))
        video = request.video and stack.enter_context(VideoWriter(request.video, request.frame_period))
        for k, photo in enumerate(request.photos):
            progress(k, len(request.photos))
            if joints is not None:
                photo = replace(photo, joints=joints[k if len(joints) > 1 else 0])
            image = read_image(photo.path)
            camera, source = photo.camera or request.camera, "episode" if photo.camera else "file"
            if camera is None:
                size = image.shape[:2]
                if size not in estimated:
                    estimated[size] = _estimate(rig, request.photos, size)
                camera, source = estimated[size], "estimated"
            mask = None if request.mask_images is None else read_image(_mask_path(request.mask_images, photo.path))
            overlay = overlayer.run(photo, image, camera, source, mask)
            report.results.append(overlay.result)
            report.files += write_overlay(overlay, stems[k], request.out, request.write_masks, inputs)
            report.failures += _failures(overlay, request)
            if video:
                video.write(overlay.picture)
        progress(len(request.photos), len(request.photos))
    if request.video:
        report.files.append(request.video)
    return report


def _estimate(rig: RigConfig, photos: Sequence[Photo], size: tuple[int, ...]) -> CameraModel:
    """The camera of all photos of one size (height, width)."""
    images = (read_image(photo.path) for photo in photos if photo.camera is None)
    return unknown_camera([image for image in images if image.shape[:2] == size], rig)


def _stems(photos: Sequence[Photo]) -> list[str]:
    """Names for the photos' results: their own, with the folder's or the ending's where those are equal."""
    stems = [photo.path.stem for photo in photos]
    if len(set(stems)) < len(stems):
        stems = [photo.path.name.replace(".", "_") for photo in photos]
    if len(set(stems)) < len(stems):
        stems = [f"{k:06d}_{stem}" for k, stem in enumerate(stems)]
    return stems


def _mask_path(masks: Path, photo: Path) -> Path:
    if not masks.is_dir():
        return masks
    for name in (photo.name, f"{photo.stem}.png", f"{photo.stem}_mask.png"):
        if (masks / name).is_file():
            return masks / name
    raise ResourceError(f"{masks} holds no mask for {photo.name}; valid: {photo.stem}.png or {photo.stem}_mask.png")


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


def _nothing_found(results: Sequence[PhotoResult], rig: RigConfig) -> str:
    """Which ids were looked for and which were seen, of photos without a pose."""
    first = results[0]
    boards = [arm.board for arm in rig.arms if arm.board]
    wanted = ", ".join(f"{board.board.ids[0]}-{board.board.ids[-1]} ({board.dictionary})" for board in boards)
    seen = ", ".join(map(str, first.ids)) or "none"
    refused = [f"{arm.name}: {arm.sighting.reason}" for arm in first.arms if arm.sighting and arm.sighting.markers]
    why = f"; {'; '.join(refused)}" if refused else ""
    more = f" (and {len(results) - 1} more photos)" if len(results) > 1 else ""
    return f"{first.path}{more}: no board gives a pose: looked for ids {wanted or 'none'}, saw {seen}{why}"


def plain(result: PhotoResult, rig: RigConfig) -> dict[str, Any]:
    """A result as plain data, for JSON. Lengths in m, angles in rad, poses (4, 4) row by row."""
    camera = result.camera
    return {
        "image": str(result.path),
        "camera": {
            "source": result.camera_source,
            "K": [list(row) for row in camera.K],
            "distortion": list(camera.distortion),
            "width": camera.width,
            "height": camera.height,
            "focal_sigma": camera.focal_sigma,
        },
        "ids_seen": list(result.ids),
        "arms": [_plain_arm(arm) for arm in result.arms],
        "T_arm2_in_arm1": _rows(result.T_arm2_in_arm1),
        "margin_m": result.margin,
        "margin_sigma_m": result.margin_sigma,
        "rig_margin_m": rig.margin if len(rig.arms) > 1 else None,
        "edge_residual_px": result.edge_residual,
        "iou": result.iou,
        "notes": list(result.notes),
    }


def _plain_arm(arm: Any) -> dict[str, Any]:
    seen = arm.sighting
    return {
        "name": arm.name,
        "board": arm.board,
        "status": str(arm.status),
        "reason": seen.reason if seen else "",
        "markers_found": len(seen.markers) if seen else 0,
        "marker_ids": list(seen.markers) if seen else [],
        "T_board_in_cam": _rows(seen.T_board_in_cam if seen else None),
        "T_base_in_cam": _rows(arm.T_base_in_cam),
        "covariance": _rows(seen.covariance if seen else None),
        "position_sigma_m": seen.position_sigma if seen else None,
        "rotation_sigma_rad": seen.rotation_sigma if seen else None,
        "reprojection_rms_px": seen.reprojection_rms if seen else None,
        "blur_px": seen.blur if seen else None,
        "edge_residual_px": arm.edge_residual,
    }


def _rows(T: Array | None) -> list[list[float]] | None:
    return None if T is None else T.tolist()
