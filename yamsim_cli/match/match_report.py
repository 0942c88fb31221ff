"""The files of a match: the scene, a JSON report, and a page with photos beside their matches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import SimulationError
from ..core.files.documents.json_text import json_text
from ..core.files.documents.yaml_document import dump_yaml
from ..core.files.writing import write_outputs
from ..core.images.jpeg import encode_jpeg
from ..core.markup import Markup, captioned_jpeg, grid_section, html_page, html_section, html_table, page_footer
from .match_run import MatchedPhoto, StationMatch

SCENE_FILE, REPORT_FILE, PAGE_FILE = "matched.yaml", "match.json", "match.html"
_JPEG_QUALITY, _SHOWN_PX = 88, 480
_MAX_SHOWN = 6  # photos on the page


def match_files(out: Path) -> tuple[Path, ...]:
    """Return the files that a match writes."""
    return out / SCENE_FILE, out / REPORT_FILE, out / PAGE_FILE


def write_match(match: StationMatch, out: Path) -> None:
    """Write all files. Raise ResourceError if they cannot be written."""
    scene = dump_yaml(match.scene.model_dump(mode="json", exclude={"name"}))
    files = (scene, json_text(report_data(match)), _page(match))
    write_outputs({path: text.encode() for path, text in zip(match_files(out), files, strict=True)}, make_folder=True)


def report_data(match: StationMatch) -> dict[str, Any]:
    """Return the report as data for JSON."""
    light = match.light
    return {
        "camera": {
            "T_cam_in_world": match.view.T_cam_in_world.round(6).tolist(),
            "K": match.view.intrinsics.K.round(4).tolist(),
            "width": match.view.intrinsics.width,
            "height": match.view.intrinsics.height,
        },
        "light": None
        if light is None
        else {
            "direction": np.round(light.light.direction, 4).tolist(),
            "ambient": np.round(light.light.ambient, 4).tolist(),
            "diffuse": np.round(light.light.diffuse, 4).tolist(),
            "arm_error": round(light.arm_error, 2),
            "table_error": round(light.table_error, 2),
        },
        "exposure_ev": round(match.exposure_ev, 3),
        "white_balance": np.round(match.white_balance, 3).tolist(),
        "plate_filled_share": round(match.plate.filled_share, 4),
        "table_photo": match.has_table_photo,
        "photos": [_photo_data(photo) for photo in match.photos],
        "notes": list(match.notes),
    }


def _photo_data(photo: MatchedPhoto) -> dict[str, Any]:
    return {
        "path": str(photo.path),
        "outline_px": round(photo.outline_px, 3),
        "iou": None if photo.iou is None else round(photo.iou, 4),
        "colour_arms": {"before": round(photo.arms_before, 2), "after": round(photo.arms_after, 2)},
        "colour_all": {"before": round(photo.all_before, 2), "after": round(photo.all_after, 2)},
    }


def require_overlap(match: StationMatch, min_iou: float | None) -> None:
    """Raise SimulationError if the arms of a photo overlap less with their mask than `min_iou`."""
    low = [photo for photo in match.photos if photo.iou is not None and min_iou is not None and photo.iou < min_iou]
    if low:
        raise SimulationError(
            f"{low[0].path}: the rendered arms overlap the mask by {low[0].iou:.3f}, less than --min-iou {min_iou:g}; "
            "check the camera, the joints and the boards with `yamsim overlay`"
        )


def _page(match: StationMatch) -> str:
    rows = [
        (
            photo.path.name,
            f"{photo.outline_px:.2f}",
            "" if photo.iou is None else f"{photo.iou:.3f}",
            f"{photo.arms_before:.1f}",
            f"{photo.arms_after:.1f}",
            f"{photo.all_before:.1f}",
            f"{photo.all_after:.1f}",
        )
        for photo in match.photos
    ]
    headings = ("photo", "outline, px", "IoU", "arms before", "arms after", "image before", "image after")
    body: list[Markup | None] = [
        html_section("Score: colour differences between scene and photo, of 255", html_table(headings, rows)),
        *(html_section("Note", text) for text in match.notes),
    ]
    for photo in match.photos[:_MAX_SHOWN]:
        images = (("photo", photo.photo), ("matched scene", photo.matched), ("scene before", photo.before))
        figures = [captioned_jpeg(text, encode_jpeg(image, _JPEG_QUALITY), _SHOWN_PX) for text, image in images]
        body.append(grid_section(photo.path.name, figures, "columns"))
    return html_page("Match", "Scene from photos", match.scene.name, [one for one in body if one], page_footer())
