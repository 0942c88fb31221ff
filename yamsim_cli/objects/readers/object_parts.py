"""An object read from a file: parts with surfaces, collision shapes and mass properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.stl import Faces

Rgba = tuple[float, float, float, float]
GREY: Rgba = (0.7, 0.7, 0.7, 1.0)  # without a colour in the file


@dataclass(frozen=True)
class SurfaceMaterial:
    """The appearance of a surface.

    Attributes:
        rgba: colour, by which a texture is multiplied.
        texture: PNG.
        specular, shininess: strength and sharpness of highlights, 0 to 1.
    """

    rgba: Rgba = GREY
    texture: bytes | None = None
    specular: float = 0.2
    shininess: float = 0.3


@dataclass(frozen=True)
class Surface:
    """Triangles (m, 3) over vertices (n, 3), m, with one material.

    Attributes:
        uv: (m, 3, 2) of triangle corners, from the image's lower left.
        convex: its convex hull is its collision geometry.
    """

    vertices: Array
    faces: Faces
    material: SurfaceMaterial = SurfaceMaterial()
    uv: Array | None = None
    convex: bool = False

    def transform(self, T: Array) -> Surface:
        """Transform by an affine map (4, 4); a reflection reverses the triangles."""
        vertices = self.vertices @ T[:3, :3].T + T[:3, 3]
        if np.linalg.det(T[:3, :3]) >= 0:
            return replace(self, vertices=vertices)
        uv = None if self.uv is None else self.uv[:, ::-1]
        return replace(self, vertices=vertices, faces=self.faces[:, ::-1], uv=uv)


@dataclass(frozen=True)
class MassProperties:
    """Mass, kg, centre (3,), m, and inertia (3, 3) about it, kg m2, in the part's frame."""

    mass: float
    centre: Array
    tensor: Array


@dataclass(frozen=True)
class RigidPart:
    """One rigid body of an object.

    Attributes:
        parent: index of an earlier part; None for the base.
        T_in_parent: pose (4, 4) with the joint at 0.
        joint: data of a `core.config.objects.articulation.LinkJoint`; None for the base.
        looks: visual surfaces.
        shapes: the file's collision shapes: data of `core.config.objects.primitives`, or surfaces.
        handles: data of `core.config.objects.articulation.Handle`.
    """

    name: str
    parent: int | None
    T_in_parent: Array
    joint: Mapping[str, Any] | None = None
    weight: MassProperties | None = None
    looks: tuple[Surface, ...] = ()
    shapes: tuple[Mapping[str, Any] | Surface, ...] | None = None
    handles: tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True)
class ObjectDescription:
    """An object as read from its file.

    Attributes:
        parts: the base first.
        fixed: the base is fixed to the world.
        unit_m: the file's unit, m; None if not stated.
        up: "x", "y" or "z"; None if not stated.
        friction: sliding.
        notes: for users, on content that was left out.
    """

    name: str
    parts: tuple[RigidPart, ...]
    fixed: bool = False
    unit_m: float | None = 1.0
    up: str | None = "z"
    friction: float | None = None
    notes: tuple[str, ...] = ()

    def part_poses(self) -> list[Array]:
        """Return parts' poses (4, 4) in the base's frame with joints at 0."""
        poses: list[Array] = []
        for part in self.parts:
            poses.append(part.T_in_parent if part.parent is None else poses[part.parent] @ part.T_in_parent)
        return poses
