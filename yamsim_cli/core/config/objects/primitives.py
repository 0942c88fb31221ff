"""Primitives for collisions and visuals, in the frame of their object."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from ...files.documents.config_base import Config, Positive, Rgba, Vector


class Capsule(Config):
    """A capsule between two points of the object's frame."""

    type: Literal["capsule"]
    start: Vector
    end: Vector
    radius: Positive
    rgba: Rgba | None = None


class Cylinder(Config):
    """An upright cylinder: centre, radius and half-height (m)."""

    type: Literal["cylinder"]
    centre: Vector
    radius: Positive
    half_height: Positive
    rgba: Rgba | None = None


class Sphere(Config):
    """A sphere: centre and radius (m)."""

    type: Literal["sphere"]
    centre: Vector
    radius: Positive
    rgba: Rgba | None = None


class Box(Config):
    """A box: centre and half-size (m) along its own axes, and their rotation about z."""

    type: Literal["box"]
    centre: Vector
    half_size: tuple[Positive, Positive, Positive]
    yaw_deg: float = 0.0
    rgba: Rgba | None = None

    @property
    def covering_discs(self) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius), m, that together cover the box seen from above."""
        long = self.half_size[0] >= self.half_size[1]
        length, width = (self.half_size[0], self.half_size[1]) if long else (self.half_size[1], self.half_size[0])
        angle = math.radians(self.yaw_deg) + (0 if long else math.pi / 2)
        count = math.ceil(length / width)
        places = [length * ((2 * k + 1) / count - 1) for k in range(count)]
        radius = math.hypot(width, length / count)
        x, y, _ = self.centre
        return tuple((x + d * math.cos(angle), y + d * math.sin(angle), radius) for d in places)


class Ring(Config):
    """A sloping rim of boxes around the object's z axis, such as the rim of a plate.

    Attributes:
        inner, outer: radius and height (m) of the rim's upper surface at its inner and outer edge.
        thickness: thickness of the boxes below that surface, m.
        segments: number of boxes.
    """

    type: Literal["ring"]
    inner: tuple[Positive, float]
    outer: tuple[Positive, float]
    thickness: Positive
    segments: int = Field(ge=3, le=128)
    rgba: Rgba | None = None


class _MeshPart(Config):
    type: str
    file: str
    low: Vector
    high: Vector

    @property
    def bounding_box(self) -> Box:
        centre = tuple((a + b) / 2 for a, b in zip(self.low, self.high, strict=True))
        half = tuple(max((b - a) / 2, 1e-5) for a, b in zip(self.low, self.high, strict=True))
        return Box(type="box", centre=centre, half_size=half)  # type: ignore[arg-type]


class HullPart(_MeshPart):
    """A convex body: the hull of a mesh file in the asset set of the object's mesh and in the part's frame.

    Attributes:
        low, high: corners of the bounding box, m, which give its size without the file.
    """

    type: Literal["hull"]


class SdfPart(_MeshPart):
    """A body of any form, also with hollows and holes, as a signed distance field, with the keys of `HullPart`.

    Contacts are exact and slow: MuJoCo finds contacts by gradient descent along the distance.
    """

    type: Literal["sdf"]


Primitive = Annotated[Sphere | Capsule | Cylinder | Box | Ring, Field(discriminator="type")]
CollisionPart = Annotated[Sphere | Capsule | Cylinder | Box | Ring | HullPart | SdfPart, Field(discriminator="type")]
