"""Lays a rig's arms over photos, one by one, and scores the fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..closing import Closing
from ..config.pictures import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError, ResourceError
from ..files import write_file
from ..geometry.camera import CameraModel
from ..images.image import Image
from ..images.image_files import Mask, grey_of
from ..images.png import encode_png
from ..resources import Locations
from ..vision.fiducials.judge import USUAL_LIMITS, Limits
from ..vision.picture_overlay import blend, draw_board, write_lines
from .arm_poses import INFERRED, RECORDED, Lens, PhotoResult, find_arms
from .joint_files import home_stands
from .outline_fit import overlap, refine, score_outlines
from .photos import MASK_ENDING, OVERLAY_ENDING, Photo
from .rendered_arms import ArmRenderer


@dataclass(frozen=True)
class OverlayOptions:
    """What to do with each photo.

    Attributes:
        trust_margin: whether the arms stand as the rig says, so that all boards together give one pose.
        refine: whether each arm's pose is moved from its board's until the outline meets the photo's edges.
        opacity: opacity of the rendered arms, 0..1.
        limits: the uncertainty up to which a board's pose counts as located.
    """

    trust_margin: bool = False
    refine: bool = False
    opacity: float = 0.55
    limits: Limits = USUAL_LIMITS


@dataclass(frozen=True)
class Overlay:
    """A photo with the arms laid over it.

    Attributes:
        result: the arms' poses and scores.
        picture: the photo with the arms over it (height, width, 3).
        labels: (height, width): 0 where no arm is, k for the rig's k-th arm.
    """

    result: PhotoResult
    picture: Image
    labels: NDArray[np.uint8]


class Overlayer(Closing):
    """Lays one rig over photos. It keeps a renderer for the last camera: close it, or use it as a context manager."""

    def __init__(
        self,
        rig: RigConfig,
        options: OverlayOptions,
        scene: SceneConfig,
        quality: RenderConfig,
        locations: Locations,
    ) -> None:
        self._rig = rig
        self._options = options
        self._make_renderer: Callable[[CameraModel], ArmRenderer] = lambda camera: ArmRenderer(
            rig, scene, quality, camera, locations
        )
        self._renderer: tuple[CameraModel, ArmRenderer] | None = None
        self._before: PhotoResult | None = None

    def run(self, photo: Photo, image: Image, lens: Lens, mask: Mask | None = None) -> Overlay:
        """The overlay of one photo: its arms are found, laid over it, and scored.

        Args:
            photo: the photo's path, joints and recorded pose.
            image: the photo, RGB (height, width, 3).
            lens: the camera that took it.
            mask: the robot's pixels in the photo (height, width), for the overlap.

        Raises:
            ConfigError: the camera or the mask does not fit the photo.
        """
        height, width = image.shape[:2]
        camera = lens.camera
        if (camera.width, camera.height) != (width, height):
            raise ConfigError(
                f"{photo.path} has {width} x {height} pixels, but the camera is calibrated for "
                f"{camera.width} x {camera.height}: give the camera file of this image size"
            )
        grey = grey_of(image)
        result = find_arms(self._rig, photo, grey, lens, self._options.trust_margin, self._before, self._options.limits)
        self._before = result
        stands = photo.stands or home_stands(self._rig)
        picture, labels = image.copy(), np.zeros((height, width), np.uint8)
        if result.bases:
            renderer = self._renderer_for(camera)
            if self._options.refine:
                result = refine(result, renderer, stands, grey, self._options.trust_margin)
            renderer.pose(result.bases, stands)
            result = score_outlines(result, renderer, grey)
            arms = renderer.render()
            labels = arms.labels
            picture = blend(image, arms.colour, labels, self._options.opacity)
        for arm in result.arms:
            if arm.sighting and arm.sighting.T_board_in_cam is not None:
                draw_board(picture, camera, arm.sighting.board, arm.sighting.T_board_in_cam)
        if mask is not None:
            result = replace(result, iou=overlap(labels, mask, photo.path))
        write_lines(picture, captions(result), _changed(picture, image))
        return Overlay(result, picture, labels)

    def _renderer_for(self, camera: CameraModel) -> ArmRenderer:
        if self._renderer is None or self._renderer[0] != camera:
            self.close()
            self._renderer = (camera, self._make_renderer(camera))
        return self._renderer[1]

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer[1].close()
            self._renderer = None


def _changed(picture: Image, image: Image) -> NDArray[np.bool_]:
    """Which pixels (height, width) of a picture differ from the photo's."""
    # Channel by channel, which is much faster.
    changed = np.zeros(image.shape[:2], dtype=np.bool_)
    for k in range(3):
        changed |= picture[..., k] != image[..., k]
    return changed


def captions(result: PhotoResult) -> list[str]:
    """The lines that are written into the picture: one for each arm, and some for the photo."""
    lines = []
    for arm in result.arms:
        text = f"{arm.name}: {arm.status}"
        if arm.sighting and (arm.sighting.markers or arm.status not in (INFERRED, RECORDED)):
            text += f", {len(arm.sighting.markers)}/{len(arm.sighting.board.ids)} markers"
            if arm.sighting.reprojection_rms is not None:
                text += f", {arm.sighting.reprojection_rms:.2f} px"
        if arm.edge_residual is not None:
            text += f", outline {arm.edge_residual:.1f} px"
        lines.append(text)
    if result.joints_source == "home" and result.bases:
        lines.append("joints not given: shown at home")
    if result.lens.source == "estimated":
        lines += _focal_lines(result)
    if result.margin is not None:
        lines.append(f"margin measured: {result.margin:.4f} m")
    return lines


def _focal_lines(result: PhotoResult) -> list[str]:
    """A line on the focal length that the boards give, or on why it is too uncertain for a pose."""
    focal = result.lens.focal
    if not focal.reason:
        return [f"focal length estimated: {focal.camera.focal:.0f} px, within {focal.low:.0f} to {focal.high:.0f} px"]
    seen = any(arm.sighting and arm.sighting.markers for arm in result.arms)
    return [f"no pose: {focal.reason}"] if seen else []


def picture_paths(out: Path, stem: str, with_mask: bool) -> list[Path]:
    """The files that `write_overlay` writes."""
    endings = (OVERLAY_ENDING, MASK_ENDING) if with_mask else (OVERLAY_ENDING,)
    return [out / f"{stem}{ending}" for ending in endings]


def write_overlay(overlay: Overlay, stem: str, out: Path, with_mask: bool) -> list[Path]:
    """The files written into `out`: an overlay's picture, and its mask if wanted. Each file is replaced in one step.

    Raises:
        ResourceError: it cannot be written.
    """
    paths = picture_paths(out, stem, with_mask)
    try:
        for path, image in zip(paths, (overlay.picture, overlay.labels), strict=False):
            write_file(path, encode_png(image))
    except OSError as error:
        raise ResourceError(f"{out} cannot be written: {error.strerror or error}; choose another --out") from error
    return paths
