"""A thing's certificate: one page with every check, its figures and its pictures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from .markup import Child, Markup, tag
from .page import document, figure

# Caption and JPEG.
Pictures = Sequence[tuple[str, bytes]]


def certificate_page(
    found: Mapping[str, Any], titles: Mapping[str, tuple[str, str]], pictures: Mapping[str, Pictures], made: str
) -> str:
    """The page as HTML.

    Args:
        found: as `certify` has it in plain data.
        titles: code -> what is wrong where it fails, and what to do.
        pictures: code -> its pictures.
        made: by what, and when; for the foot of the page.
    """
    checks = found["checks"]
    failed = sum(check["ok"] is False for check in checks)
    open_ = sum(check["ok"] is None for check in checks)
    cells = [
        figure(f"{found['mass_kg'] * 1000:g} g", "mass"),
        figure(f"{found['collision']['parts']:,}", f"parts that touch: {found['collision']['kind']}"),
        figure(f"{len(checks) - failed - open_} of {len(checks)}", f"checks passed; {open_} not made"),
    ]
    body = [
        tag("p", "Certificate", class_="kicker"),
        tag("h1", str(found["thing"])),
        _verdict(failed, open_),
        tag("div", cells, class_="figures"),
        [_section(check, titles[check["code"]], pictures.get(check["code"], ())) for check in checks],
    ]
    return document(f"{found['thing']}: certificate", body, made)


def _verdict(failed: int, open_: int) -> Markup:
    if failed:
        text, kind = f"{failed} of its checks failed: not to be recorded with as it is.", "error"
    elif open_:
        text, kind = "Nothing was found wrong; what could not be checked is said below.", "fine"
    else:
        text, kind = "Nothing was found wrong.", "fine"
    return tag("p", tag("span", text), class_=f"verdict {kind}")


def _section(check: Mapping[str, Any], texts: tuple[str, str], pictures: Pictures) -> Markup:
    title, advice = texts
    word, kind = {True: ("passed", "fine"), False: ("failed", "error"), None: ("not checked", "warning")}[check["ok"]]
    said: list[Child] = [tag("p", tag("code", check["code"], class_=kind), f" {word}", class_="note")]
    if check["ok"] is False:
        said.append(tag("p", f"{title}: {check['note']}. What to do: {advice}."))
    elif check["note"]:
        said.append(tag("p", f"{check['note']}."))
    rows = [tag("tr", tag("th", name, scope="row"), tag("td", str(value))) for name, value in check["figures"].items()]
    if rows:
        said.append(tag("table", tag("tbody", rows)))
    if pictures:
        said.append(tag("div", [_picture(caption, data) for caption, data in pictures], class_="strips"))
    return tag("section", tag("h2", check["code"]), said)


def _picture(caption: str, data: bytes) -> Markup:
    source = f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"
    return tag("figure", tag("img", src=source, alt=caption, width=320), tag("figcaption", caption))
