"""Compares the simulated arms with photos of the real ones: outlines with edges, and masks with each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..closing import Closing
from ..config.pictures import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError, ResourceError
from ..gap.figures import Gap
from ..geometry.camera import CameraModel
from ..images.image import Image
from ..images.image_files import grey_of, read_image
from ..images.jpeg import encode_jpeg
from ..overlay.arm_poses import Lens, find_arms, unknown_lens
from ..overlay.outline_fit import score_outlines
from ..overlay.photos import Photo
from ..overlay.rendered_arms import ArmRenderer
from ..progress import Progress
from ..report.gap_page import CaptionedJpeg
from ..resources import Locations
from ..vision.picture_overlay import blend, write_lines
from .recorded import Taken, chosen_photos, photo_of, stands_at, taken_photos

# Pictures on a page, how much of the simulated arms is seen there, and the JPEGs' quality.
_SHOWN, _OPACITY, _QUALITY = 2, 0.4, 85


@dataclass(frozen=True)
class PhotoRequest:
    """Which photos, and what is known of them.

    Attributes:
        most: how many are compared at most.
        camera: the camera that took them; None for what the recording says, or else the boards.
        name: of the camera in the recordings; None for the one that stands still.
    """

    most: int
    camera: CameraModel | None = None
    name: str | None = None


@dataclass(frozen=True)
class PhotoGap:
    """What a photo says of the simulated arms.

    Attributes:
        taken: which photo.
        outline: median distance of their outline to the photo's edges, px; None where no arm is in sight.
        measured_outline: the same of the arms as their joints were measured: what is left where there is no gap.
        iou: overlap of the two, 0..1.
        picture: the simulated arms over the photo.
    """

    taken: Taken
    outline: float | None
    measured_outline: float | None
    iou: float
    picture: Image


def compare_photos(
    gaps: Sequence[Gap],
    rig: RigConfig,
    request: PhotoRequest,
    scene: SceneConfig,
    quality: RenderConfig,
    locations: Locations,
    progress: Progress,
) -> tuple[dict[str, Any], list[CaptionedJpeg]]:
    """What photos of recordings say, as plain data, and the worst of them as pictures.

    Raises:
        UsageError: no recording has photos, or none by that camera.
        DatasetError: a frame is damaged.
        ConfigError: the camera is of other photos.
        ResourceError: no photo shows where the camera stood, or nothing can render here.
    """
    camera, taken = taken_photos(gaps, request.name)
    chosen = chosen_photos(taken, request.most)
    found: list[PhotoGap] = []
    figures: list[PhotoGap] = []
    with _Renderers(rig, scene, quality, locations) as renderers:
        for k, one in enumerate(chosen):
            progress(k, len(chosen))
            if compared := _compared(one, camera, chosen, request, rig, renderers):
                figures.append(compared)
                found = sorted([*found, compared], key=_badness, reverse=True)[:_SHOWN]
        progress(len(chosen), len(chosen))
    if not figures:
        raise ResourceError(
            f"no photo of camera {camera!r} shows where it stood, first {chosen[0].path}: its frames say nothing, and "
            "no board is in sight; give recordings with extrinsics, or leave --pictures out"
        )
    return _plain(camera, figures, len(chosen) - len(figures)), [_shown(one) for one in found]


class _Renderers(Closing):
    """Renders arms for photos, and keeps the renderer of the last camera."""

    def __init__(self, rig: RigConfig, scene: SceneConfig, quality: RenderConfig, locations: Locations) -> None:
        self._parts = rig, scene, quality, locations
        self._last: tuple[CameraModel, ArmRenderer] | None = None

    def of(self, camera: CameraModel) -> ArmRenderer:
        if self._last is None or self._last[0] != camera:
            self.close()
            rig, scene, quality, locations = self._parts
            self._last = camera, ArmRenderer(rig, scene, quality, camera, locations)
        return self._last[1]

    def close(self) -> None:
        """Free the renderer."""
        if self._last is not None:
            self._last[1].close()
            self._last = None


def _compared(
    taken: Taken, name: str, chosen: Sequence[Taken], request: PhotoRequest, rig: RigConfig, renderers: _Renderers
) -> PhotoGap | None:
    """What one photo says; None where it does not say where its camera stood."""
    image = read_image(taken.path)
    photo = photo_of(taken, name, rig, image)
    lens = _lens(photo, image, chosen, request, rig)
    grey = grey_of(image)
    result = find_arms(rig, photo, grey, lens, trust_margin=False)
    if not result.bases:
        return None
    renderer = renderers.of(lens.camera)
    renderer.pose(result.bases, stands_at(taken.gap.motion, taken.sample, rig))
    measured, measured_mask = score_outlines(result, renderer, grey), renderer.flat_labels() > 0
    renderer.pose(result.bases, stands_at(taken.gap.simulated, taken.sample, rig))
    simulated, mask = score_outlines(result, renderer, grey), renderer.flat_labels() > 0
    arms = renderer.render()
    picture = blend(image, arms.colour, arms.labels, _OPACITY)
    union = int((mask | measured_mask).sum())
    iou = int((mask & measured_mask).sum()) / union if union else 1.0
    lines = [f"simulated, {taken.gap.motion.times[taken.sample]:.2f} s, frame {taken.frame}"]
    if simulated.edge_residual is not None:
        lines.append(f"outline {simulated.edge_residual:.1f} px, overlap {iou:.3f}")
    write_lines(picture, lines, arms.labels > 0)
    return PhotoGap(taken, simulated.edge_residual, measured.edge_residual, iou, picture)


def _lens(photo: Photo, image: Image, chosen: Sequence[Taken], request: PhotoRequest, rig: RigConfig) -> Lens:
    height, width = image.shape[:2]
    if (camera := request.camera) is not None and (camera.width, camera.height) != (width, height):
        raise ConfigError(
            f"{photo.path} has {width} x {height} pixels, but the camera is calibrated for {camera.width} x "
            f"{camera.height}: give the camera file of this image size"
        )
    if request.camera is not None:
        return Lens.known(request.camera, "file")
    if photo.camera is not None:
        return Lens.known(photo.camera, "episode")
    return unknown_lens(_same_size(chosen, image), (height, width), rig)


def _same_size(chosen: Sequence[Taken], image: Image) -> Iterator[Image]:
    for one in chosen:
        other = read_image(one.path)
        if other.shape[:2] == image.shape[:2]:
            yield other


def _badness(found: PhotoGap) -> tuple[float, float]:
    return -1.0 if found.outline is None else found.outline, 1 - found.iou


def _plain(camera: str, figures: Sequence[PhotoGap], without: int) -> dict[str, Any]:
    worst = max(figures, key=_badness)
    return {
        "camera": camera,
        "photos": len(figures),
        "without_pose": without,
        "outline_px": _spread([one.outline for one in figures], max),
        "measured_outline_px": _spread([one.measured_outline for one in figures], max),
        "iou": _spread([one.iou for one in figures], min),
        "worst": _place(worst),
        "frames": [
            {
                **_place(one),
                "image": str(one.taken.path),
                "outline_px": one.outline,
                "measured_outline_px": one.measured_outline,
                "iou": one.iou,
            }
            for one in figures
        ],
    }


def _place(found: PhotoGap) -> dict[str, Any]:
    taken = found.taken
    time = float(taken.gap.motion.times[taken.sample])
    return {"recording": taken.gap.name, "frame": taken.frame, "time_s": time}


def _spread(values: Sequence[float | None], worst: Any) -> dict[str, float] | None:
    known = [value for value in values if value is not None]
    return {"mean": float(np.mean(known)), "worst": float(worst(known))} if known else None


def _shown(found: PhotoGap) -> CaptionedJpeg:
    place = _place(found)
    outline = "no arm in sight" if found.outline is None else f"outline {found.outline:.1f} px from the photo's edges"
    caption = (
        f"Frame {place['frame']} of {place['recording']} at {place['time_s']:.2f} s: the simulated arm over the photo; "
        f"{outline}, overlap {found.iou:.3f}."
    )
    return CaptionedJpeg(caption, encode_jpeg(found.picture, _QUALITY))
