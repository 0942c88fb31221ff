"""HTML and SVG as text. All text except `Markup` is escaped, so that data cannot inject elements into a page."""

from __future__ import annotations

import base64
import datetime
import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from .. import __version__
from .files.writing import write_output

# HTML elements without content.
_VOID_ELEMENTS = frozenset({"meta", "img", "br", "hr"})

_KEPT_SPACES = "\n\N{NO-BREAK SPACE}"  # kept by a page although `str.isprintable` is false for them

# The browser loads only the page itself: no script, font or picture from other sources, whatever the data contains.
_CONTENT_SECURITY_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

_STYLE = Path(__file__).with_name("report.css")


class Markup(str):
    """Markup made by `html_tag` and `join_markup`."""

    __slots__ = ()


HtmlChild = str | int | float | None | Iterable["HtmlChild"]


def html_tag(name: str, /, *children: HtmlChild, **attributes: object) -> Markup:
    """Return an element.

    Args:
        children: text, which is escaped; markup; or lists of both. None is left out.
        attributes: `_` becomes `-`, and is removed at the end (`class_`). The value None leaves the attribute out.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{html.escape(_sanitize_text(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _VOID_ELEMENTS:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{join_markup(children)}</{name}>")


def join_markup(children: Iterable[HtmlChild]) -> Markup:
    """Return the concatenated markup of children."""
    return Markup("".join(map(_escape_child, children)))


def html_page(title: str, kicker: str, heading: str, body: Iterable[HtmlChild], made: str) -> str:
    """Return a whole HTML page; `kicker`, the kind of page, is above the heading, and `made` is the footer."""
    head = [
        html_tag("meta", charset="utf-8"),
        html_tag("meta", http_equiv="Content-Security-Policy", content=_CONTENT_SECURITY_POLICY),
        html_tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        html_tag("meta", name="referrer", content="no-referrer"),
        html_tag("title", title),
        # The project's own style sheet must not be escaped.
        Markup(f"<style>{_STYLE.read_text(encoding='utf-8')}</style>"),
    ]
    top = [html_tag("p", kicker, class_="kicker"), html_tag("h1", heading)]
    main = html_tag("main", top, body, html_tag("footer", made))
    return "<!doctype html>\n" + html_tag("html", html_tag("head", head), html_tag("body", main), lang="en") + "\n"


def page_footer() -> str:
    """Return the footer of a page: yamsim's version and the date."""
    return f"Made by yamsim {__version__} on {datetime.date.today().isoformat()}."


def write_page(text: str, path: Path) -> None:
    """Write a page, replacing an existing file; raise ResourceError if it cannot be written."""
    write_output(path, text.encode(), "--html")


def html_section(title: str, *children: HtmlChild) -> Markup:
    """Return a section with its heading."""
    return html_tag("section", html_tag("h2", title), children)


def grid_section(title: str, figures: Sequence[Markup], kind: str, legend: Markup | None = None) -> Markup | None:
    """Return a section of figures in a grid of class `columns`, `plans` or `strips`; None without figures."""
    return html_section(title, legend, html_tag("div", figures, class_=kind)) if figures else None


def key_figures(figures: Iterable[tuple[str, str]]) -> Markup:
    """Return the large figures at the top of a page, each a value and its label."""
    return html_tag(
        "div",
        [html_tag("div", html_tag("b", value), html_tag("span", label)) for value, label in figures],
        class_="figures",
    )


def verdict_sentence(text: str, kind: str) -> Markup:
    """Return the sentence that summarizes a page; `kind` is `fine`, `warning` or `error`."""
    return html_tag("p", html_tag("span", text), class_=f"verdict {kind}")


def captioned_plot(title: str, picture: Markup, caption: str) -> Markup:
    """Return a plot with its title and caption."""
    return html_tag("figure", html_tag("h3", title), picture, html_tag("figcaption", caption))


def jpeg_image(data: bytes, alt: str, width: int | None = None) -> Markup:
    """Return a JPEG file as an embedded image; `width` in px."""
    return html_tag("img", src=f"data:image/jpeg;base64,{base64.b64encode(data).decode()}", alt=alt, width=width)


def captioned_jpeg(caption: str, data: bytes, width: int) -> Markup:
    """Return a JPEG file with its caption; `width` in px."""
    return html_tag("figure", jpeg_image(data, caption, width), html_tag("figcaption", caption))


def plot_legend(entries: Iterable[tuple[str | None, str]]) -> Markup:
    """Return a legend of pairs: a mark's class in the style sheet (None for the default dot) and its meaning."""
    return html_tag(
        "div", [html_tag("span", html_tag("i", class_=kind), text) for kind, text in entries], class_="legend"
    )


def header_row(headings: Iterable[str]) -> Markup:
    """Return a table's row of column headings."""
    return html_tag("tr", [html_tag("th", text, scope="col") for text in headings])


def table_rows(cells: Iterable[Sequence[str]]) -> list[Markup]:
    """Return the rows of a table; the first cell of each row is its heading."""
    return [
        html_tag("tr", html_tag("th", row[0], scope="row"), [html_tag("td", cell) for cell in row[1:]]) for row in cells
    ]


def html_table(headings: Iterable[str], cells: Iterable[Sequence[str]]) -> Markup:
    """Return a table with column headings; the first cell of each row is its heading."""
    return html_tag("table", html_tag("thead", header_row(headings)), html_tag("tbody", table_rows(cells)))


def percent(rate: float, digits: int = 1) -> str:
    """Return a rate of 0..1 as text in percent."""
    return f"{rate * 100:.{digits}f}\N{NO-BREAK SPACE}%"


def _escape_child(child: HtmlChild) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    if isinstance(child, str | int | float):
        return html.escape(_sanitize_text(child))
    return join_markup(child)


def _sanitize_text(value: object) -> str:
    """Return floats with two decimals, and strings without characters that control or reverse other text."""
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return "".join(
        letter if letter.isprintable() or letter in _KEPT_SPACES else "\N{REPLACEMENT CHARACTER}"
        for letter in str(value)
    )
