"""Escaped markup, and axes with round numbers."""

from __future__ import annotations

from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yamsim_cli.core.markup import Markup, html_tag, join_markup, percent
from yamsim_cli.plots import PixelScale, format_number

EVIL = "<script>alert(1)</script>\"' onload=x --> ]]> &amp;"


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, name: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((name, dict(attributes)))

    def handle_data(self, data: str) -> None:
        self.text += data


def read(markup: str) -> Reader:
    reader = Reader()
    reader.feed(markup)
    reader.close()
    return reader


@pytest.mark.parametrize("text", [EVIL, "</p><p>", "'\"<>&", "<!--", "a\u202eb"])
def test_text_and_attributes_stay_text(text: str) -> None:
    page = read(html_tag("p", text, title=text))
    assert [name for name, _ in page.tags] == ["p"]
    shown = text.replace("\u202e", "\N{REPLACEMENT CHARACTER}")
    assert page.text == shown
    assert page.tags[0][1] == {"title": shown}


@given(st.text(), st.text())
def test_no_text_makes_an_element(text: str, attribute: str) -> None:
    page = read(html_tag("div", text, html_tag("b", text), class_=attribute))
    assert [(name, list(attributes)) for name, attributes in page.tags] == [("div", ["class"]), ("b", [])]


def test_elements_nest_and_none_is_left_out() -> None:
    assert (
        html_tag("ul", [html_tag("li", "a & b"), None, html_tag("li", 1.50, " mm")])
        == "<ul><li>a &amp; b</li><li>1.5 mm</li></ul>"
    )
    assert html_tag("rect", x=1.0, stroke_width=0.333, class_=None) == '<rect x="1" stroke-width="0.33"></rect>'
    assert html_tag("img", src="data:x") == '<img src="data:x">'
    assert join_markup(["<", Markup("<br>")]) == "&lt;<br>"


def test_markup_that_was_put_together_as_text_is_escaped() -> None:
    assert html_tag("p", html_tag("b", "x") + " and more") == "<p>&lt;b&gt;x&lt;/b&gt; and more</p>"


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0, 10, [0, 2, 4, 6, 8, 10]),
        (0.3, 0.55, [0.3, 0.35, 0.4, 0.45, 0.5, 0.55]),
        (-0.18, 0.18, [-0.1, 0, 0.1]),
        (0.18, -0.18, [-0.1, 0, 0.1]),
        (5, 5, [5]),
    ],
)
def test_ticks_are_round_and_within(low: float, high: float, ticks: list[float]) -> None:
    assert PixelScale(low, high, 0, 100).round_tick_values(6) == pytest.approx(ticks)


def test_a_scale_can_run_backwards() -> None:
    scale = PixelScale(0.2, -0.2, 0, 100)
    assert (scale(0.2), scale(0), scale(-0.2)) == pytest.approx((0, 50, 100))
    assert PixelScale(3, 3, 0, 100)(3) == 50


def test_numbers_are_written_without_noise() -> None:
    assert format_number(0.1 + 0.2) == "0.3"
    assert format_number(-0.25) == "\N{MINUS SIGN}0.25"
    assert format_number(-1e-12) == "0"
    assert percent(0.896) == "89.6\N{NO-BREAK SPACE}%"
