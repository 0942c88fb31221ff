"""Draw every kitchen object into one picture, `docs/kitchen.png`, and print the table of `docs/kitchen.md`.

python -m tools.kitchen_sheet
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import cv2
import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.images.png import encode_png
from yamsim_cli.session_opener import SessionOpener

_TILE, _FINE, _COLUMNS = (200, 150), (800, 600), 6
_FILE = Path(__file__).resolve().parents[1] / "docs" / "kitchen.png"


def main() -> None:
    """Draw, write and print."""
    opener = SessionOpener(os.environ, lambda text: print(text, file=sys.stderr), str)
    where = opener.choose_gl_backend(opener.find_locations())
    # After the choice of a backend.
    import mujoco

    from yamsim_cli.core.rendering.renderer import SceneRenderer
    from yamsim_cli.objects.certify.tested_object import (
        add_view_camera,
        compile_or_raise,
        object_on_ground_spec,
        read_tested_object,
    )

    tiles = []
    for name in (name for name in where.config_names("objects") if name.startswith("kitchen_")):
        item = load_config(ObjectConfig, "objects", name, where)
        looked = read_tested_object(item, {}, where)
        points = looked.merged_visual_surface[0]
        low, high = points.min(axis=0), points.max(axis=0)
        size = float(np.linalg.norm(high - low))
        spec = add_view_camera(object_on_ground_spec(looked), (low + high) / 2, 0.92 * size)
        spec.visual.global_.offwidth, spec.visual.global_.offheight = _FINE
        model = compile_or_raise(spec)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with SceneRenderer(model, _TILE, _FINE) as renderer:
            tile = renderer.render(data, "view")
        cv2.putText(tile, item.name, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (20, 20, 20), 1, cv2.LINE_AA)
        tiles.append(tile)
        sys.stdout.write(_row(item, (high - low) * 100) + "\n")
    while len(tiles) % _COLUMNS:
        tiles.append(np.full_like(tiles[0], 205))
    rows = [np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)]
    _FILE.write_bytes(encode_png(np.vstack(rows)))


def _row(item: ObjectConfig, size: np.ndarray) -> str:
    assert item.shape is not None
    stuffs = " and ".join(dict.fromkeys(m.stuff for m in item.shape.materials.values() if m.stuff != "paint"))
    held = "no"
    if item.grasp is not None:
        wide = 2000 * item.grasp.opening
        held = f"{wide:.3g} mm by friction" if item.grasp.friction else f"{wide:.3g} mm by a weld"
    extent = " x ".join(f"{value:.3g}" for value in size)
    return f"| `{item.name}` | {extent} | {stuffs} | {1000 * item.inertia.mass:.0f} g | {held} |"


if __name__ == "__main__":
    main()
