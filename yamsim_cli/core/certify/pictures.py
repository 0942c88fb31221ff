"""Pictures of what checks looked at."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from ..images.jpeg import encode_jpeg
from ..vision.renderer import SceneRenderer
from .outcome import Outcome, View

_SIZE = (320, 240)
_FINE = (640, 480)
_QUALITY = 85


def draw(outcomes: Mapping[str, Outcome]) -> dict[str, list[tuple[str, bytes]]]:
    """Code -> pictures, each a caption and a JPEG.

    Raises:
        ResourceError: nothing can be drawn here.
    """
    return {code: [(view.caption, _picture(view)) for view in outcome.views] for code, outcome in outcomes.items()}


def _picture(view: View) -> bytes:
    data = mujoco.MjData(view.model)
    data.qpos[:] = view.qpos
    mujoco.mj_forward(view.model, data)
    with SceneRenderer(view.model, _SIZE, _FINE) as renderer:
        return encode_jpeg(renderer.render(data, "view"), _QUALITY)
