"""Small pictures of every rig, and three tests of a picture: positions, pixels, colours.

In that order, since a picture with correct mean colours may still show a board at the wrong place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import mujoco
import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.viewers.show.rig_views import ViewScene, set_up_views

DATA = Path(__file__).with_name("data")
FAILED = Path(__file__).with_name("failed")

SIZE = (320, 240)
RIGS = ("single", "bimanual", "russet")
VIEWS = ("front", "near_top", "low_close_up")

# Parts of a mask, and the root body of each part.
PARTS = ("arm", "arm2_arm", "base_board", "arm2_base_board", "base_mount", "arm2_base_mount")

# Board centres of each rig in `world`, m: from margin and board offset, independent of yamsim's code.
BOARD_CENTRES = {
    "single": {"base_board": (0.0196, 0.17523, -0.0047)},
    "bimanual": {
        "base_board": (0.0196, -0.35 + 0.17523, -0.0047),
        "arm2_base_board": (0.0196, 0.35 + 0.17523, -0.0047),
    },
    "russet": {
        "base_board": (0.0196, -0.2955 + 0.17523, -0.0047),
        "arm2_base_board": (0.0196, 0.2955 - 0.17523, -0.0047),
    },
}

# Tolerances of a golden picture. Software renderers agree to the bit; GPUs differ at edges.
MAX_CENTRE_PX = 1.0
MIN_IOU = 0.97
MAX_MEAN_COLOUR = 2.0


@dataclass(frozen=True)
class GoldenPicture:
    """A picture of a rig: colours (h, w, 3), and the part at each pixel (h, w): 0 or index in PARTS + 1."""

    colour: np.ndarray
    mask: np.ndarray
    stage: ViewScene


def take(
    rig: RigConfig, locations: Locations, tamper: Callable[[mujoco.MjModel], None] | None = None
) -> dict[str, GoldenPicture]:
    """Return the pictures of a rig by view, with primitives, which are always available; `tamper` may change the model
    first.
    """
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    stage = set_up_views(Blueprint(rig, scene), locations, quality, SIZE)
    if tamper:
        tamper(stage.model)
        mujoco.mj_forward(stage.model, stage.data)
    part_of_geom = np.array([_part(stage.model, int(body)) for body in stage.model.geom_bodyid] + [0], np.uint8)
    with stage.open_renderer() as renderer:
        return {
            view: GoldenPicture(
                renderer.render(stage.data, view).copy(),
                part_of_geom[renderer.render_geom_ids(stage.data, view)],
                stage,
            )
            for view in VIEWS
        }


def _part(model: mujoco.MjModel, body: int) -> int:
    while model.body_parentid[body]:
        body = model.body_parentid[body]
    name = model.body(body).name
    return PARTS.index(name) + 1 if name in PARTS else 0


def golden(rig: str, view: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the committed colours and mask of a picture."""
    colour = cv2.imread(str(DATA / f"{rig}_{view}.png"), cv2.IMREAD_COLOR)
    mask = cv2.imread(str(DATA / f"{rig}_{view}_mask.png"), cv2.IMREAD_UNCHANGED)
    assert colour is not None, "no golden picture: make golden-update"
    assert mask is not None, "no golden mask: make golden-update"
    return colour[..., ::-1], mask


def faults(shot: GoldenPicture, rig: str, view: str) -> list[str]:
    """Return the differences from the golden picture, the gravest first."""
    found = centre_faults(shot, rig, view)
    colour, mask = golden(rig, view)
    for number, part in enumerate(PARTS, start=1):
        ours, theirs = shot.mask == number, mask == number
        union = (ours | theirs).sum()
        if union and (iou := (ours & theirs).sum() / union) < MIN_IOU:
            found.append(f"mask: {part} overlaps the golden one by {iou:.3f}, at least {MIN_IOU}")
    difference = np.abs(shot.colour.astype(int) - colour).mean()
    if difference > MAX_MEAN_COLOUR:
        found.append(f"colour: {difference:.1f} off on average, at most {MAX_MEAN_COLOUR}")
    return found


def centre_faults(shot: GoldenPicture, rig: str, view: str) -> list[str]:
    """Boards whose middle is not where the figures put it, seen from above, where nothing hides them."""
    found = []
    for part, centre in BOARD_CENTRES[rig].items() if view == "near_top" else ():
        rows, columns = np.nonzero(shot.mask == PARTS.index(part) + 1)
        if len(rows) == 0:
            found.append(f"centre: {part} is not seen at all")
            continue
        expected = shot.stage.cameras[view].project_point(centre)
        off = float(np.hypot(columns.mean() - expected[0], rows.mean() - expected[1]))
        if off > MAX_CENTRE_PX:
            found.append(f"centre: {part} is seen {off:.1f} px from where it should be, at most {MAX_CENTRE_PX}")
    return found


def save_failure(shot: GoldenPicture, rig: str, view: str) -> Path:
    """Write expected and actual picture and their difference side by side, for a person."""
    colour, mask = golden(rig, view)
    FAILED.mkdir(exist_ok=True)
    difference = np.minimum(np.abs(shot.colour.astype(int) - colour) * 4, 255).astype(np.uint8)
    masks = [np.repeat((m * 40)[..., None], 3, axis=2) for m in (mask, shot.mask)]
    masks.append(np.repeat(((mask != shot.mask) * 255).astype(np.uint8)[..., None], 3, axis=2))
    sheet = np.vstack([np.hstack([colour, shot.colour, difference]), np.hstack(masks)])
    path = FAILED / f"{rig}_{view}_expected_actual_difference.png"
    cv2.imwrite(str(path), sheet[..., ::-1])
    return path


def update(locations: Locations) -> list[Path]:
    """Make today's pictures the golden ones."""
    DATA.mkdir(exist_ok=True)
    written = []
    for name in RIGS:
        rig = load_config(RigConfig, "rigs", name, locations)
        for view, shot in take(rig, locations).items():
            for path, image in (
                (DATA / f"{name}_{view}.png", shot.colour[..., ::-1]),
                (DATA / f"{name}_{view}_mask.png", shot.mask),
            ):
                cv2.imwrite(str(path), image)
                written.append(path)
    return written
