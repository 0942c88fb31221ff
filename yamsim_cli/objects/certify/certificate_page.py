"""Format an object's certificate as an HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from yamsim_cli.core.markup import (
    HtmlChild,
    Markup,
    captioned_jpeg,
    html_page,
    html_section,
    html_tag,
    key_figures,
    table_rows,
    verdict_sentence,
)

# Caption and JPEG of each picture.
CaptionedPictures = Sequence[tuple[str, bytes]]


def certificate_page(
    found: Mapping[str, Any],
    titles: Mapping[str, tuple[str, str]],
    pictures: Mapping[str, CaptionedPictures],
    made: str,
) -> str:
    """Return a certificate's HTML page.

    Args:
        found: from `certify.CertificationResult.to_json_data`.
        titles: check code -> name of the fault, and advice.
        pictures: by check code.
        made: text at the foot.
    """
    checks = found["checks"]
    failed = sum(check["ok"] is False for check in checks)
    skipped = sum(check["ok"] is None for check in checks)
    figures = [
        (f"{found['mass_kg'] * 1000:g} g", "mass"),
        (f"{found['collision']['parts']:,}", f"collision parts: {found['collision']['kind']}"),
        (f"{len(checks) - failed - skipped} of {len(checks)}", f"checks passed; {skipped} skipped"),
    ]
    sections = [_check_section(check, titles[check["code"]], pictures.get(check["code"], ())) for check in checks]
    thing = str(found["thing"])
    body = [_certificate_verdict(failed, skipped), key_figures(figures), sections]
    return html_page(f"{thing}: certificate", "Certificate", thing, body, made)


def _certificate_verdict(failed: int, skipped: int) -> Markup:
    if failed:
        return verdict_sentence(
            f"{failed} of its checks failed: correct the object before you record with it.", "error"
        )
    if skipped:
        return verdict_sentence("No check failed, but some could not run; each gives its reason below.", "fine")
    return verdict_sentence("All checks passed.", "fine")


def _check_section(check: Mapping[str, Any], texts: tuple[str, str], pictures: CaptionedPictures) -> Markup:
    title, advice = texts
    word, kind = {True: ("passed", "fine"), False: ("failed", "error"), None: ("not checked", "warning")}[check["ok"]]
    content: list[HtmlChild] = [html_tag("p", html_tag("code", check["code"], class_=kind), f" {word}", class_="note")]
    if check["ok"] is False:
        content.append(html_tag("p", f"{title}: {check['note']}. What to do: {advice}."))
    elif check["note"]:
        content.append(html_tag("p", f"{check['note']}."))
    if figures := table_rows((name, str(value)) for name, value in check["figures"].items()):
        content.append(html_tag("table", html_tag("tbody", figures)))
    if pictures:
        content.append(html_tag("div", [captioned_jpeg(*picture, 320) for picture in pictures], class_="strips"))
    return html_section(check["code"], content)
