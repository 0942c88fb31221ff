"""Photos with a rig's arms laid over them, and how well they fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from ..config.recording import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError, ResourceError
from ..files import write_file
from ..geometry.camera import CameraModel
from ..images.image import Image
from ..images.image_files import Mask, grey_of
from ..images.png import encode_png
from ..resources import Locations
from ..scene.compose import Meshes
from ..vision.overlay import blend, draw_board, write_lines
from .arm_poses import INFERRED, RECORDED, Lens, PhotoResult, find_arms
from .joint_files import home_joints
from .outline_fit import overlap, refine, score_outlines
from .photos import MASK_ENDING, OVERLAY_ENDING, Photo
from .rendered_arms import ArmDrawer


@dataclass(frozen=True)
class OverlayOptions:
    """What to do with each photo.

    Attributes:
        trust_margin: both arms stand as the rig says, so the camera is found from both boards at once.
        refine: move each arm's pose until its outline meets the photo's edges, starting from its board's.
        opacity: of the drawn arms, 0..1.
    """

    trust_margin: bool = False
    refine: bool = False
    opacity: float = 0.55


@dataclass(frozen=True)
class Overlay:
    """A photo's result, its picture with the arms over it (height, width, 3), and where each arm is in it.

    Attributes:
        labels: (height, width): 0 for none, k for the rig's k-th arm.
    """

    result: PhotoResult
    picture: Image
    labels: NDArray[np.uint8]


class Overlayer:
    """Runs photos of one rig. Close it, or use it as a context manager: it keeps a renderer for the last camera."""

    def __init__(
        self,
        rig: RigConfig,
        options: OverlayOptions,
        scene: SceneConfig,
        quality: RenderConfig,
        locations: Locations,
        meshes: Meshes,
    ) -> None:
        self._rig = rig
        self._options = options
        self._make_drawer: Callable[[CameraModel], ArmDrawer] = lambda camera: ArmDrawer(
            rig, scene, quality, camera, locations, meshes
        )
        self._drawer: tuple[CameraModel, ArmDrawer] | None = None

    def run(self, photo: Photo, image: Image, lens: Lens, mask: Mask | None = None) -> Overlay:
        """Find the arms in one photo, lay them over it, and score the fit.

        Args:
            photo: what is known of it beside its camera.
            image: RGB (height, width, 3).
            lens: through which it was taken.
            mask: where the robot is in the photo (height, width), for the overlap.

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
        result = find_arms(self._rig, photo, grey, lens, self._options.trust_margin)
        joints = home_joints(self._rig)[0] if photo.joints is None else photo.joints
        picture, labels = image.copy(), np.zeros((height, width), np.uint8)
        if result.bases:
            drawer = self._drawer_for(camera)
            if self._options.refine:
                result = refine(result, drawer, joints, grey, self._options.trust_margin)
            drawer.pose(result.bases, joints)
            result = score_outlines(result, drawer, grey)
            drawn = drawer.draw()
            labels = drawn.labels
            picture = blend(image, drawn.colour, labels, self._options.opacity)
        for arm in result.arms:
            if arm.sighting and arm.sighting.T_board_in_cam is not None:
                draw_board(picture, camera, arm.sighting.board, arm.sighting.T_board_in_cam)
        if mask is not None:
            result = replace(result, iou=overlap(labels, mask, photo.path))
        write_lines(picture, captions(result), _changed(picture, image))
        return Overlay(result, picture, labels)

    def _drawer_for(self, camera: CameraModel) -> ArmDrawer:
        if self._drawer is None or self._drawer[0] != camera:
            self.close()
            self._drawer = (camera, self._make_drawer(camera))
        return self._drawer[1]

    def close(self) -> None:
        """Free the renderer."""
        if self._drawer is not None:
            self._drawer[1].close()
            self._drawer = None

    def __enter__(self) -> Overlayer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _changed(picture: Image, image: Image) -> NDArray[np.bool_]:
    """Which pixels (height, width) of a picture are no longer the photo's; channel by channel, which is much faster."""
    changed = np.zeros(image.shape[:2], dtype=np.bool_)
    for k in range(3):
        changed |= picture[..., k] != image[..., k]
    return changed


def captions(result: PhotoResult) -> list[str]:
    """A line for each arm, and one for the whole, as they are written into the picture."""
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
        lines.append("joints not given: drawn at home")
    if result.lens.source == "estimated":
        lines += _focal_lines(result)
    if result.margin is not None:
        lines.append(f"margin measured: {result.margin:.4f} m")
    return lines


def _focal_lines(result: PhotoResult) -> list[str]:
    """What the boards tell of an unknown lens, or why it gives no pose."""
    focal = result.lens.focal
    if not focal.reason:
        return [f"focal length estimated: {focal.camera.focal:.0f} px, within {focal.low:.0f} to {focal.high:.0f} px"]
    seen = any(arm.sighting and arm.sighting.markers for arm in result.arms)
    return [f"no pose: {focal.reason}"] if seen else []


def picture_paths(out: Path, stem: str, with_mask: bool) -> list[Path]:
    """What `write_overlay` writes."""
    endings = (OVERLAY_ENDING, MASK_ENDING) if with_mask else (OVERLAY_ENDING,)
    return [out / f"{stem}{ending}" for ending in endings]


def write_overlay(overlay: Overlay, stem: str, out: Path, with_mask: bool) -> list[Path]:
    """Write a result's picture, and its segmentation if wanted, into a folder; each file is replaced whole.

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
