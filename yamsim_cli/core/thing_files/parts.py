"""What was read of a thing: parts with surfaces, shapes and weight; plain numbers in metres, z up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..geometry.se3 import Array
from ..geometry.stl import Faces

Rgba = tuple[float, float, float, float]
GREY: Rgba = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Material:
    """How a surface looks.

    Attributes:
        rgba: its colour; with a texture, what that is multiplied by.
        texture: a PNG file, or None.
    """

    rgba: Rgba = GREY
    texture: bytes | None = None
    specular: float = 0.2
    shininess: float = 0.3


@dataclass(frozen=True)
class Surface:
    """Triangles (m, 3) over vertices (n, 3), m, with one material.

    Attributes:
        uv: texture coordinates (m, 3, 2) of each triangle's corners, from the picture's lower left; or None.
        convex: whether its hull is meant where it touches.
    """

    vertices: Array
    faces: Faces
    material: Material = Material()
    uv: Array | None = None
    convex: bool = False

    def moved(self, T: Array) -> Surface:
        """The same at a pose, or under any affine map (4, 4); a mirror turns the triangles round."""
        vertices = self.vertices @ T[:3, :3].T + T[:3, 3]
        if np.linalg.det(T[:3, :3]) >= 0:
            return replace(self, vertices=vertices)
        uv = None if self.uv is None else self.uv[:, ::-1]
        return replace(self, vertices=vertices, faces=self.faces[:, ::-1], uv=uv)


@dataclass(frozen=True)
class Weight:
    """Mass, kg; centre of mass (3,), m; and inertia (3, 3) about it, kg m2; in the part's frame."""

    mass: float
    centre: Array
    tensor: Array


@dataclass(frozen=True)
class Part:
    """One body of a thing.

    Attributes:
        name: in the file.
        parent: place of its parent among the parts, None for the base; parents come first.
        T_in_parent: pose (4, 4) with the joint at 0.
        joint: as `config.things.articulation.LinkJoint` takes it; None for the base.
        weight: as the file says, or None.
        looks: what is seen.
        shapes: what touches, as the file says: primitives as `config.things.primitives` takes them, or surfaces. None
            where the file has none.
        handles: as `config.things.articulation.Handle` takes them.
    """

    name: str
    parent: int | None
    T_in_parent: Array
    joint: Mapping[str, Any] | None = None
    weight: Weight | None = None
    looks: tuple[Surface, ...] = ()
    shapes: tuple[Mapping[str, Any] | Surface, ...] | None = None
    handles: tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True)
class ReadThing:
    """A thing as a file has it.

    Attributes:
        name: in the file, empty where it has none.
        parts: the base first.
        fixed: whether its base is said to stand still.
        unit_m: how long the file's unit is, m; None where the file does not say.
        up: "x", "y" or "z"; None where the file does not say.
        friction: sliding friction, where the file says.
        notes: what was left out, for people.
    """

    name: str
    parts: tuple[Part, ...]
    fixed: bool = False
    unit_m: float | None = 1.0
    up: str | None = "z"
    friction: float | None = None
    notes: tuple[str, ...] = field(default=())
