"""What a check finds, and what it is a picture of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco

from ..geometry.se3 import Array

Figures = Mapping[str, float | int | str]


@dataclass(frozen=True)
class View:
    """A state of a scene to be drawn: its camera is called `view`."""

    model: mujoco.MjModel
    qpos: Array
    caption: str


@dataclass(frozen=True)
class Outcome:
    """What one check found.

    Attributes:
        ok: None where it was not checked.
        figures: what was measured, by names with units.
        note: what is wrong, or why it was not checked; empty where all is well.
    """

    ok: bool | None
    figures: Figures = field(default_factory=dict)
    note: str = ""
    views: tuple[View, ...] = ()


def unchecked(why: str) -> Outcome:
    """Of a check that does not apply, or cannot be made."""
    return Outcome(None, note=why)


def short(value: Any, digits: int = 4) -> float:
    """A number to so many digits that count: figures are read, and compared."""
    return float(f"{float(value):.{digits}g}")
