"""Compares the simulated arms with photos of the real ones: outlines with the photos' edges, and masks with masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config.pictures import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ResourceError
from ..gap.figures import Gap
from ..geometry.camera import CameraModel
from ..images.image import Image
from ..images.image_files import grey_of, read_image
from ..images.jpeg import encode_jpeg
from ..overlay.arm_poses import find_arms
from ..overlay.lenses import PhotoLenses
from ..overlay.outline_fit import overlap, score_outlines
from ..overlay.rendered_arms import ArmRenderers
from ..progress import Progress
from ..report.gap_page import Shown
from ..resources import Locations
from ..vision.picture_overlay import blend, write_lines
from .recorded import Taken, chosen_photos, photo_of, stands_at, taken_photos

_SHOWN = 2  # pictures on a page
_OPACITY = 0.4  # of the simulated arms in a picture
_QUALITY = 85  # of the pictures' JPEGs


@dataclass(frozen=True)
class PhotoRequest:
    """Which photos of recordings to compare.

    Attributes:
        most: largest number of photos.
        camera: the camera of all photos; None for the recording's, or else an estimate from the boards.
        name: the camera's name in the recordings; None for the one that stands still.
    """

    most: int
    camera: CameraModel | None = None
    name: str | None = None


@dataclass(frozen=True)
class PhotoGap:
    """The simulated arms compared with a photo.

    Attributes:
        outline: median distance of their outline to the photo's edges, px; None where no arm is in sight.
        measured_outline: the same of the arms at their measured joints: the distance without a gap.
        iou: overlap of the simulated and the measured arms, 0..1.
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
) -> tuple[dict[str, Any], list[Shown]]:
    """The comparison with photos of recordings as plain data, and the worst photos as pictures.

    Raises:
        UsageError: no recording has photos, or none by that camera.
        DatasetError: a frame is damaged.
        ConfigError: the camera is calibrated for another image size.
        ResourceError: no photo gives the camera's pose, or no OpenGL context can be made.
    """
    camera, taken = taken_photos(gaps, request.name)
    chosen = chosen_photos(taken, request.most)
    found: list[PhotoGap] = []
    figures: list[PhotoGap] = []
    lenses = PhotoLenses(rig, [one.path for one in chosen], request.camera)
    with ArmRenderers(rig, scene, quality, locations) as renderers:
        for k, one in enumerate(chosen):
            progress(k, len(chosen))
            if compared := _compared(one, camera, rig, lenses, renderers):
                figures.append(compared)
                found = sorted([*found, compared], key=_badness, reverse=True)[:_SHOWN]
        progress(len(chosen), len(chosen))
    if not figures:
        raise ResourceError(
            f"no photo of camera {camera!r} shows where it stood, first {chosen[0].path}: its frames have no "
            "extrinsics, and no board is in sight; give recordings with extrinsics, or leave --pictures out"
        )
    return _plain(camera, figures, len(chosen) - len(figures)), [_shown(one) for one in found]


def _compared(
    taken: Taken, camera: str, rig: RigConfig, lenses: PhotoLenses, renderers: ArmRenderers
) -> PhotoGap | None:
    """The comparison of one photo; None where neither its frame nor a board gives the camera's pose."""
    image = read_image(taken.path)
    photo = photo_of(taken, camera, rig, image)
    lens, grey = lenses.of(photo, image), grey_of(image)
    result = find_arms(rig, photo, grey, lens, trust_margin=False)
    if not result.bases:
        return None
    renderer = renderers.of(lens.camera)
    renderer.pose(result.bases, stands_at(taken.gap.motion, taken.sample, rig))
    measured, measured_mask = score_outlines(result, renderer, grey), renderer.flat_labels() > 0
    renderer.pose(result.bases, stands_at(taken.gap.simulated, taken.sample, rig))
    simulated, iou = score_outlines(result, renderer, grey), overlap(renderer.flat_labels() > 0, measured_mask)
    arms = renderer.render()
    picture = blend(image, arms.colour, arms.labels, _OPACITY)
    lines = [f"simulated, {taken.gap.motion.times[taken.sample]:.2f} s, frame {taken.frame}"]
    if simulated.edge_residual is not None:
        lines.append(f"outline {simulated.edge_residual:.1f} px, overlap {iou:.3f}")
    write_lines(picture, lines, arms.labels > 0)
    return PhotoGap(taken, simulated.edge_residual, measured.edge_residual, iou, picture)


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


def _shown(found: PhotoGap) -> Shown:
    place = _place(found)
    outline = "no arm in sight" if found.outline is None else f"outline {found.outline:.1f} px from the photo's edges"
    caption = (
        f"Frame {place['frame']} of {place['recording']} at {place['time_s']:.2f} s: the simulated arm over the photo; "
        f"{outline}, overlap {found.iou:.3f}."
    )
    return Shown(caption, encode_jpeg(found.picture, _QUALITY))
