"""HTML and SVG as text. Everything that is not markup itself is escaped, so that no data can break out of it."""

from __future__ import annotations

import html
from collections.abc import Iterable

# Elements that never have content, in HTML.
_VOID = frozenset({"meta", "img", "br", "hr"})

_SPACES = "\n\N{NO-BREAK SPACE}"


class Markup(str):
    """Text that is markup, made by `tag`, `join` and `style`. Anything else in a page is escaped."""

    __slots__ = ()


Child = str | int | float | None | Iterable["Child"]


def tag(name: str, /, *children: Child, **attributes: object) -> Markup:
    """An element.

    Args:
        children: text, which is escaped; markup; or lists of them. None is left out.
        attributes: `_` stands for `-`, and at the end for nothing (`class_`). None leaves the attribute out.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{html.escape(_text(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _VOID:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{join(children)}</{name}>")


def join(children: Iterable[Child]) -> Markup:
    """Children one after the other."""
    return Markup("".join(map(_child, children)))


def style(css: str) -> Markup:
    """A style element. The style sheet is not escaped, so it must be the project's own."""
    return Markup(f"<style>{css}</style>")


def _child(child: Child) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    if isinstance(child, str | int | float):
        return html.escape(_text(child))
    return join(child)


def _text(value: object) -> str:
    """A value as text: floats with two decimals, and strings without characters that control or reverse other text."""
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return "".join(
        letter if letter.isprintable() or letter in _SPACES else "\N{REPLACEMENT CHARACTER}" for letter in str(value)
    )
