"""Write a certificate's HTML page with pictures."""

from __future__ import annotations

from pathlib import Path

import mujoco

from yamsim_cli.core import markup
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.rendering.renderer import SceneRenderer

from .certificate_page import certificate_page
from .certify import CHECKS, CertificationResult
from .check_outcome import CheckView

_PICTURE_SIZE, _RENDERED_SIZE = (320, 240), (640, 480)  # px, of a picture, and of its rendering
_JPEG_QUALITY = 85  # JPEG


def write_certificate_page(certified: CertificationResult, path: Path) -> None:
    """Write a certified object's HTML page. Raises `ResourceError`."""
    titles = {code: (check.title, check.advice) for code, check in CHECKS.items()}
    pictures = {
        code: [(view.caption, _render_view(view)) for view in outcome.views]
        for code, outcome in certified.outcomes.items()
    }
    markup.write_page(certificate_page(certified.to_json_data(), titles, pictures, markup.page_footer()), path)


def _render_view(view: CheckView) -> bytes:
    data = mujoco.MjData(view.model)
    data.qpos[:] = view.qpos
    mujoco.mj_forward(view.model, data)
    with SceneRenderer(view.model, _PICTURE_SIZE, _RENDERED_SIZE) as renderer:
        return encode_jpeg(renderer.render(data, "view"), _JPEG_QUALITY)
