"""Simple shapes, in the frame of what they belong to."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from .base import Config, Positive, Rgba, Vector


class Capsule(Config):
    """A capsule between two points of the object's frame."""

    type: Literal["capsule"]
    start: Vector
    end: Vector
    radius: Positive
    rgba: Rgba | None = None


class Cylinder(Config):
    """An upright cylinder: centre, radius and half its height."""

    type: Literal["cylinder"]
    centre: Vector
    radius: Positive
    half_height: Positive
    rgba: Rgba | None = None


class Sphere(Config):
    """A ball: centre and radius."""

    type: Literal["sphere"]
    centre: Vector
    radius: Positive
    rgba: Rgba | None = None


class Box(Config):
    """A block that stands upright: centre, half its size along its own axes, and how far these are turned about z."""

    type: Literal["box"]
    centre: Vector
    half_size: tuple[Positive, Positive, Positive]
    yaw_deg: float = 0.0
    rgba: Rgba | None = None

    @property
    def discs(self) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius) that cover it seen from above, m: as many as it takes squares to cover it."""
        long = self.half_size[0] >= self.half_size[1]
        length, width = (self.half_size[0], self.half_size[1]) if long else (self.half_size[1], self.half_size[0])
        angle = math.radians(self.yaw_deg) + (0 if long else math.pi / 2)
        count = math.ceil(length / width)
        places = [length * ((2 * k + 1) / count - 1) for k in range(count)]
        radius = math.hypot(width, length / count)
        x, y, _ = self.centre
        return tuple((x + d * math.cos(angle), y + d * math.sin(angle), radius) for d in places)


class Ring(Config):
    """A sloping rim of boxes around the object's z axis, such as a plate's.

    Attributes:
        inner, outer: radius and height (m) of the rim's upper surface at its inner and outer edge.
        thickness: of the boxes, below that surface.
        segments: how many boxes go round.
    """

    type: Literal["ring"]
    inner: tuple[Positive, float]
    outer: tuple[Positive, float]
    thickness: Positive
    segments: int = Field(ge=3, le=128)
    rgba: Rgba | None = None


Primitive = Annotated[Sphere | Capsule | Cylinder | Box | Ring, Field(discriminator="type")]
