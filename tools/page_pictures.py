"""Draw the pictures of README and of single pages into `docs/images/`.

python -m tools.page_pictures           # all
python -m tools.page_pictures russet    # or some
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Pillow

from tools.task_pictures import few_colours, first_success, pictures
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.session_opener import SessionOpener

_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
_WHITE = 255
_JPEG_QUALITY = 75  # 1..100; keeps `fold_napkin.jpg` near 100 kB


def _russet(opener: SessionOpener, where: Locations) -> np.ndarray:
    """The rig `russet` from the front."""
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.scene.blueprint import Blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.viewers.show.rig_views import render_views, set_up_views

    scene = load_config(SceneConfig, "scenes", "studio", where)
    quality = load_config(RenderConfig, "quality", "high", where)
    blueprint = Blueprint(opener.load_rig("russet", where, None, None), scene)
    where = opener.with_mesh_folders(where, visual_mesh_sets(blueprint), quality)
    return render_views(set_up_views(blueprint, where, quality, (720, 480)))["front.png"]


def _episode(opener: SessionOpener, where: Locations) -> np.ndarray:
    """The banana over the plate, from the scene camera and from the wrist."""
    from yamsim_cli.core.config.recording import SCENE_CAMERA

    session = _session(opener, where, size="400x300", wrist=True)
    with first_success(session) as success:
        (seen,) = pictures(*success, (0.66,), session.config.recorded_cameras)
    wrist = next(image for camera, image in seen.items() if camera != SCENE_CAMERA)
    return _grid([[seen[SCENE_CAMERA], wrist]], 8)


def _finray(opener: SessionOpener, where: Locations) -> np.ndarray:
    """Two fin-ray fingers around a tennis ball that they lift, from close by."""
    from yamsim_cli.core.config.recording import SCENE_CAMERA
    from yamsim_cli.core.config.scene import FixedCamera

    given = {"rig": "single_finray", "object": "tennis_ball", "grasp": "contact", "size": "560x350"}
    moment = 0.45  # the share of the attempt after which the ball is a little above the table
    session = _session(opener, where, **given)
    with first_success(session) as (simulator, done):
        simulator.state_replay.set_state(done.recorded_states[round(moment * (len(done.recorded_states) - 1))].qpos)
        x, y, z = map(float, simulator.state_replay.data.body("tennis_ball").xpos)
    near = FixedCamera(position=(x + 0.15, y - 0.29, z + 0.07), look_at=(x, y, z + 0.03), fovy_deg=35)
    scene = session.config.scene.model_copy(update={"scene_camera": near})
    closer = Session(session.config.model_copy(update={"scene": scene}), session.locations)
    with first_success(closer) as success:
        (seen,) = pictures(*success, (moment,), (SCENE_CAMERA,))
    return seen[SCENE_CAMERA]


def _fold_napkin(opener: SessionOpener, where: Locations) -> np.ndarray:
    """A folded napkin: the views of the table of the camera above and of the right wrist."""
    session = _session(opener, where, task="fold_napkin", size="600x450")
    with first_success(session) as success:
        seen = pictures(*success, (0.1, 0.2, 0.4, 0.6, 0.8), ("top", "right"))
    table = [of["top"][90:315, 150:450] for of in seen]
    return _grid([table, [np.asarray(Pillow.fromarray(of["right"]).reduce(2)) for of in seen]], 3)


def _shadows(opener: SessionOpener, where: Locations) -> np.ndarray:
    """Shadows in the left wrist camera of `hang_mug`: with steps of 1.3 mm, as in `balanced`, and in `high`."""
    stepped = {"name": "stepped", "shadow_map_px": 1024, "smooth_shadows": False}
    seen = []
    for quality, changes in (("balanced", stepped), ("balanced", {}), ("high", {})):
        session = _session(opener, where, task="hang_mug", quality=quality)
        changed = session.with_values(render=session.config.render.model_copy(update=changes))
        with first_success(changed) as success:
            seen += pictures(*success, (0.385,), ("left",))
    return _grid([[of["left"][:240, 300:620] for of in seen]], 6)


def _session(opener: SessionOpener, where: Locations, quality: str = "high", **given: Any) -> Session:
    return opener.with_scene_meshes(
        Session(opener.load_record_config("default", where, quality=quality, **given), where)
    )


def _grid(rows: Sequence[Sequence[np.ndarray]], gap: int) -> np.ndarray:
    """Lay images of one size out in rows, with `gap` white pixels between them."""
    padded = [
        np.hstack([np.pad(image, ((0, gap), (0, gap), (0, 0)), constant_values=_WHITE) for image in row])
        for row in rows
    ]
    return np.vstack(padded)[:-gap, :-gap]


_DRAWN: dict[str, Callable[[SessionOpener, Locations], np.ndarray]] = {
    "russet.png": _russet,
    "episode.png": _episode,
    "finray.png": _finray,
    "fold_napkin.jpg": _fold_napkin,
    "shadows.png": _shadows,
}


def main(names: list[str]) -> None:
    """Draw and write."""
    opener = SessionOpener(os.environ, lambda text: print(text, file=sys.stderr), str)
    # What draws is settled before anything imports MuJoCo.
    where = opener.choose_gl_backend(opener.find_locations())
    from yamsim_cli.core.images.jpeg import encode_jpeg

    for name, draw in _DRAWN.items():
        if names and Path(name).stem not in names:
            continue
        file, image = _FOLDER / name, draw(opener, where)
        if file.suffix == ".jpg":
            file.write_bytes(encode_jpeg(image, _JPEG_QUALITY))
        else:
            few_colours(image).save(file, optimize=True)
        sys.stdout.write(f"{file}: {file.stat().st_size} bytes\n")


if __name__ == "__main__":
    main(sys.argv[1:])
