"""What is asked for when a config is made of a read thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Collision = Literal["auto", "primitives", "decompose", "sdf", "hull"]

#: What an even filling weighs where nobody says, kg/m3: most plastics, ripe fruit and water are near it.
DENSITY = 1000.0


@dataclass(frozen=True)
class Wishes:
    """What a file does not say, or a user wants otherwise.

    Attributes:
        name: what the thing is called.
        mass: of all of it, kg; or `density`, kg/m3. Without either, as the file says, or of `DENSITY`.
        collision: how it touches; "auto" takes what the file says, primitives where they fit, or else convex parts.
        base: whether it can be moved; without, as the file says.
        friction: sliding friction; without, as the file says, or 0.8.
    """

    name: str
    mass: float | None = None
    density: float | None = None
    collision: Collision = "auto"
    base: Literal["free", "fixed"] | None = None
    friction: float | None = None
