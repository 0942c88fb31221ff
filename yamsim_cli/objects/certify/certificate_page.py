"""Write an object's certificate as an HTML page with pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco

from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.markup import (
    HtmlChild,
    Markup,
    captioned_jpeg,
    html_page,
    html_section,
    html_tag,
    key_figures,
    page_footer,
    table_rows,
    verdict_sentence,
    write_page,
)
from yamsim_cli.core.rendering.renderer import SceneRenderer

from .certify import CHECKS, CertificationResult
from .check_outcome import CheckView

_PICTURE_SIZE, _RENDERED_SIZE = (320, 240), (640, 480)  # px, of a picture, and of its rendering
_JPEG_QUALITY = 85  # JPEG


def write_certificate_page(certified: CertificationResult, path: Path) -> None:
    """Write a certified object's HTML page. Raises `ResourceError`."""
    found = certified.to_json_data()
    checks = found["checks"]
    failed = sum(check["ok"] is False for check in checks)
    skipped = sum(check["ok"] is None for check in checks)
    figures = [
        (f"{found['mass_kg'] * 1000:g} g", "mass"),
        (f"{found['collision']['parts']:,}", f"collision parts: {found['collision']['kind']}"),
        (f"{len(checks) - failed - skipped} of {len(checks)}", f"checks passed; {skipped} skipped"),
    ]
    sections = [_check_section(check, certified.outcomes[check["code"]].views) for check in checks]
    thing = str(found["thing"])
    body = [_certificate_verdict(failed, skipped), key_figures(figures), sections]
    write_page(html_page(f"{thing}: certificate", "Certificate", thing, body, page_footer()), path)


def _render_view(view: CheckView) -> bytes:
    data = mujoco.MjData(view.model)
    data.qpos[:] = view.qpos
    mujoco.mj_forward(view.model, data)
    with SceneRenderer(view.model, _PICTURE_SIZE, _RENDERED_SIZE) as renderer:
        return encode_jpeg(renderer.render(data, "view"), _JPEG_QUALITY)


def _certificate_verdict(failed: int, skipped: int) -> Markup:
    if failed:
        return verdict_sentence(
            f"{failed} of its checks failed: correct the object before you record with it.", "error"
        )
    if skipped:
        return verdict_sentence("No check failed, but some could not run; each gives its reason below.", "fine")
    return verdict_sentence("All checks passed.", "fine")


def _check_section(check: Mapping[str, Any], views: Sequence[CheckView]) -> Markup:
    word, kind = {True: ("passed", "fine"), False: ("failed", "error"), None: ("not checked", "warning")}[check["ok"]]
    content: list[HtmlChild] = [html_tag("p", html_tag("code", check["code"], class_=kind), f" {word}", class_="note")]
    if check["ok"] is False:
        fault = CHECKS[check["code"]]
        content.append(html_tag("p", f"{fault.title}: {check['note']}. What to do: {fault.advice}."))
    elif check["note"]:
        content.append(html_tag("p", f"{check['note']}."))
    if figures := table_rows((name, str(value)) for name, value in check["figures"].items()):
        content.append(html_tag("table", html_tag("tbody", figures)))
    if views:
        pictures = [captioned_jpeg(view.caption, _render_view(view), 320) for view in views]
        content.append(html_tag("div", pictures, class_="strips"))
    return html_section(check["code"], content)
