"""The target's number fields on the page, as a person types; a browser is in tests/e2e."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="yamsim[view] is not installed")

from yamsim_cli.core.geometry.se3 import pose, rotation_z
from yamsim_cli.viewers.teleop_page import TargetFields, hand_heading


class Field:
    """A field of a page; `typed` is a user's action, setting `value` the program's."""

    def __init__(self, value: Any) -> None:
        self._value = value
        self.writes = 0
        self._tell: Callable[[Any], Any]

    def on_update(self, tell: Callable[[Any], Any]) -> None:
        self._tell = tell

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        self.writes += value != self._value
        self._value = value
        asyncio.run(self._tell(SimpleNamespace(client=None)))

    def arrives(self, value: Any) -> None:
        """As viser acts before it notifies anybody."""
        self._value = value

    def typed(self, value: Any) -> None:
        self.arrives(value)
        asyncio.run(self._tell(SimpleNamespace(client="a browser")))


class Page:
    """The part of viser that the fields need."""

    def add_vector3(self, label: str, value: Any, **_: Any) -> Field:
        self.place = Field(value)
        return self.place

    def add_number(self, label: str, value: Any, **_: Any) -> Field:
        self.heading = Field(value)
        return self.heading


T_HOME = pose((0.3, 0.0, 0.2001), rotation_z(np.radians(-90.0)))


@pytest.fixture
def page() -> Page:
    return Page()


@pytest.fixture
def fields(page: Page) -> TargetFields:
    made = TargetFields(page)  # type: ignore[arg-type]
    made.show(T_HOME)
    return made


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("yamsim_cli.viewers.teleop_page.time.monotonic", lambda: now[0])
    return now


def test_the_fields_follow_the_target(fields: TargetFields, page: Page) -> None:
    assert (page.place.value, page.heading.value) == ((0.3, 0.0, 0.2), 0.0)
    assert not fields.has_typed_numbers
    moved = T_HOME.copy()
    moved[0, 3] = 0.35
    fields.show(moved)
    assert page.place.value == (0.35, 0.0, 0.2)


def test_a_number_is_taken_when_no_digit_has_come_for_a_second(
    fields: TargetFields, page: Page, clock: list[float]
) -> None:
    for z in (0.0, 0.1, 0.15):
        page.place.typed((0.3, 0.0, z))
        assert not fields.is_typing_done
        clock[0] += 0.9
        assert not fields.is_typing_done
    clock[0] += 0.11
    assert fields.is_typing_done
    assert np.allclose(fields.apply_typed(T_HOME)[:3, 3], (0.3, 0.0, 0.15))
    assert not fields.has_typed_numbers


def test_nothing_is_written_over_what_is_typed(fields: TargetFields, page: Page) -> None:
    page.place.typed((0.4, 0.0, 0.2))
    moved = T_HOME.copy()
    moved[1, 3] = 0.05
    fields.show(moved)
    assert page.place.value == (0.4, 0.0, 0.2)
    target = fields.apply_typed(moved)
    assert np.allclose(target[:3, 3], (0.4, 0.05, 0.2001)), "and it moves only what was typed"
    fields.show(target)
    assert page.place.value == (0.4, 0.05, 0.2)


def test_a_number_that_has_come_but_is_not_told_of_yet_is_not_written_over(fields: TargetFields, page: Page) -> None:
    page.place.arrives((0.4, 0.0, 0.2))
    fields.show(T_HOME)
    assert page.place.value == (0.4, 0.0, 0.2)


def test_a_typed_number_is_not_sent_back(fields: TargetFields, page: Page) -> None:
    before = page.place.writes
    page.place.typed((0.4, 0.0, 0.2))
    fields.show(fields.apply_typed(T_HOME))
    assert page.place.writes == before, "it would arrive over the next digit"


def test_a_target_that_became_another_is_shown(fields: TargetFields, page: Page) -> None:
    page.place.typed((0.3, 0.0, -0.1))
    lifted = fields.apply_typed(T_HOME)
    lifted[2, 3] = 0.012
    fields.show(lifted)
    assert page.place.value == (0.3, 0.0, 0.012)


def test_a_heading_turns_the_hand_about_the_vertical(fields: TargetFields, page: Page) -> None:
    page.heading.typed(30.0)
    target = fields.apply_typed(T_HOME)
    assert np.degrees(hand_heading(target)) == pytest.approx(30.0)
    assert np.array_equal(target[:3, 3], T_HOME[:3, 3])
