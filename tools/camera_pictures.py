"""Draw one moment of a pick and place through each camera effect and preset, and in looks, into `docs/images/`.

python -m tools.camera_pictures            # all
python -m tools.camera_pictures gallery    # or some, by the names of their files
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import cv2
import numpy as np
from PIL import Image as Pillow

from tools.task_pictures import first_success
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.procedural.textures import Texture
from yamsim_cli.session_opener import SessionOpener

if TYPE_CHECKING:
    from yamsim_cli.core.files.resources import Locations

_SIZE = "320x240"
_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
_FRAMES = 3  # up to the shown one, for delay and blur
_JPEG_QUALITY = 88
_LOOKS = 6
_PROCEDURAL_LOOKS = 3  # of each set
_TEXTURE_SEED, _TEXTURE_REPEAT, _TEXTURE_SIZE = 3, 4, 160  # the last in px
_TEXTURE_COLOURS = ((0.80, 0.65, 0.45), (0.45, 0.30, 0.20))

# Title -> effects, each strong enough to see in a small picture.
EFFECTS: dict[str, dict[str, Any]] = {
    "pinhole": {},
    "distortion": {"distortion": [-0.4, 0.15, 0.0, 0.0]},
    "fisheye": {"lens": "fisheye", "distortion": [-0.05, 0.0, 0.0, 0.0]},
    "principal_point": {"principal_point": [0.12, -0.08]},
    "exposure_ev, white_balance": {"exposure_ev": -1, "white_balance": [1.3, 1.0, 0.7]},
    "noise": {"full_well_e": 400, "read_noise_e": 8},
    "jpeg_quality: 15": {"jpeg_quality": 15},
    "h264_qp: 40": {"h264_qp": 40},
    "exposure_ms: 60": {"exposure_ms": 60, "shutter_samples": 12},
    "readout_ms: 64": {"readout_ms": 64, "shutter_samples": 16},
    "delay_frames: 2": {"delay_frames": 2},
    "crop, letterbox: 1.6": {"crop": [0.2, 0.2, 0.9, 0.9], "letterbox": 1.6},
}
# Ranges, look and quality of each image of the gallery.
GALLERY = (
    ("none", 0, "fast"), ("none", 0, "high"), ("none", 0, "photo"),
    ("looks", 1, "high"), ("looks", 1, "photo"), ("looks", 3, "photo"),
)  # fmt: skip
_GALLERY_SIZE = "480x360"
PRESETS = ("d405", "zed_mini", "wide_fisheye")


def main() -> None:
    """Draw and write."""
    opener = SessionOpener(os.environ, lambda text: print(text, file=sys.stderr), str)
    where = opener.choose_gl_backend(opener.find_locations())
    sets = [(name, look) for name in ("looks", "heldout") for look in range(1, _PROCEDURAL_LOOKS + 1)]
    drawn: dict[str, Callable[[], tuple[list[np.ndarray], int]]] = {
        "camera_effects": lambda: ([draw_effects(opener, where, *each) for each in EFFECTS.items()], 4),
        "camera_presets": lambda: ([draw_effects(opener, where, name, {"like": name}) for name in PRESETS], 3),
        "looks": lambda: ([draw_look(opener, where, "default", look) for look in range(1, _LOOKS + 1)], 3),
        "procedural_looks": lambda: ([draw_look(opener, where, *each) for each in sets], _PROCEDURAL_LOOKS),
        "textures": lambda: ([draw_texture(name) for name in get_args(Texture) if name != "plain"], 7),
        "gallery": lambda: ([draw_look(opener, where, *each, size=_GALLERY_SIZE) for each in GALLERY], 3),
    }
    for name in sys.argv[1:] or drawn:
        try:
            tiles, columns = drawn[name]()
        except ResourceError as error:
            if name != "gallery":
                raise
            sys.stderr.write(f"not drawn: {name}: {error}\n")
            continue
        write(name, grid(tiles, columns))


def draw_effects(opener: SessionOpener, where: Locations, title: str, keys: dict[str, Any]) -> np.ndarray:
    """Return the titled image of a camera with effects."""
    from yamsim_cli.camera_effects.config import CameraEffects
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.recording import CameraEffectsEntry

    config = opener.load_record_config("default", where, size=_SIZE, quality="balanced")
    effects = (
        load_config(CameraEffects, "camera_effects", keys["like"], where)
        if "like" in keys
        else CameraEffects.model_validate(keys)
    )
    entries = (CameraEffectsEntry(effects=effects),) if keys else ()
    session = opener.with_scene_meshes(Session(config.model_copy(update={"camera_effects": entries}), where))
    return titled(draw(session), title)


def draw_texture(name: str) -> np.ndarray:
    """Return the titled image of a procedural texture."""
    from yamsim_cli.core.config.variation import SurfaceSample
    from yamsim_cli.core.scene.randomized_model import texture_image

    surface = SurfaceSample(name, _TEXTURE_COLOURS, _TEXTURE_REPEAT, _TEXTURE_SEED)
    return titled(texture_image(surface, _TEXTURE_SIZE), name)


def draw_look(
    opener: SessionOpener, where: Locations, ranges: str, look: int, quality: str = "balanced", size: str = _SIZE
) -> np.ndarray:
    """Return the titled image of a look, with the ranges of a file in `configs/randomization/`."""
    config = opener.load_record_config("default", where, size=size, quality=quality, randomization=ranges)
    session = opener.with_scene_meshes(Session(config.model_copy(update={"look": look}), where))
    parts = ([] if quality == "balanced" else [quality]) + ([] if ranges in ("default", "none") else [ranges])
    return titled(draw(session), ", ".join([*parts, *([f"look_{look}"] if look else [])]))


def draw(session: Session) -> np.ndarray:
    """Return the scene camera's image at the fastest moment of the first success of seed 0."""
    from yamsim_cli.core.episode.attempt_payload import render_recorded_images

    with first_success(session) as (simulator, done):
        states = [state.qpos for state in done.recorded_states]
        joints = np.array([qpos[simulator.scene.first_arm.joint_qpos] for qpos in states])
        last = _FRAMES + int(np.abs(np.diff(joints[_FRAMES - 1 :], axis=0)).max(axis=1).argmax())
        shown = states[last - _FRAMES + 1 : last + 1]
        images = [image.copy() for _, _, image in render_recorded_images(simulator, replace(done.attempt), shown)]
    return images[-1]


def titled(image: np.ndarray, title: str) -> np.ndarray:
    """Return a copy of an image with its title in a corner."""
    image = image.copy()
    (width, _), _ = cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
    cv2.rectangle(image, (0, 0), (width + 10, 20), (245, 245, 245), -1)
    cv2.putText(image, title, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (25, 25, 25), 1, cv2.LINE_AA)
    return image


def grid(tiles: list[np.ndarray], columns: int) -> np.ndarray:
    """Return images of equal size in rows, with white lines between."""
    padded = [np.pad(tile, ((2, 2), (2, 2), (0, 0)), constant_values=255) for tile in tiles]
    return np.vstack([np.hstack(padded[k : k + columns]) for k in range(0, len(padded), columns)])


def write(name: str, image: np.ndarray) -> None:
    """Write an image as JPEG."""
    file = _FOLDER / f"{name}.jpg"
    Pillow.fromarray(image).save(file, quality=_JPEG_QUALITY, optimize=True)
    sys.stdout.write(f"{file}: {file.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
