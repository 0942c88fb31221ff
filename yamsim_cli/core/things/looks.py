"""A part's surfaces as files: OBJ and PNG where they have a picture, STL where they have one colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..assets.reduction import LIMIT_MM
from ..files import sha256_bytes
from ..geometry.obj import obj_bytes
from ..geometry.stl import stl_bytes
from ..thing_files.parts import Material, Surface
from .bake import rebaked
from .coarser import coarser
from .weigh import whole

# What is drawn quickly, faces; a surface with more is reduced as far as it stays within the limit.
MOST_DRAWN = 20_000
_TRIED = (6_000, 12_000, 24_000, 48_000)


@dataclass(frozen=True)
class Looks:
    """What is seen of a part: meshes as configs have them, without their set, and the files that they name."""

    meshes: tuple[Mapping[str, Any], ...]
    files: Mapping[str, bytes]


def looks_of(name: str, surfaces: tuple[Surface, ...]) -> Looks:
    """Surfaces with the same material as one mesh each; files are called after `name`."""
    groups: dict[tuple[Any, ...], list[Surface]] = {}
    for surface in surfaces:
        material = surface.material
        picture = material.texture and sha256_bytes(material.texture)
        key = (picture, material.rgba, material.specular, material.shininess)
        groups.setdefault(key, []).append(surface)
    meshes: list[Mapping[str, Any]] = []
    files: dict[str, bytes] = {}
    for number, group in enumerate(groups.values()):
        mesh, made = _mesh(f"{name}_{number}", tuple(group))
        meshes.append(mesh)
        files |= made
    return Looks(tuple(meshes), files)


def _mesh(name: str, group: tuple[Surface, ...]) -> tuple[dict[str, Any], dict[str, bytes]]:
    material = group[0].material
    entry: dict[str, Any] = {
        "rgba": [round(part, 4) for part in material.rgba],
        "specular": round(material.specular, 3),
        "shininess": round(material.shininess, 3),
    }
    vertices, faces, uv, texture = _drawn(group, material)
    if uv is None or texture is None:
        return {"file": f"{name}.stl", **entry}, {f"{name}.stl": stl_bytes(vertices, faces)}
    files = {f"{name}.obj": obj_bytes(vertices, faces, uv), f"{name}.png": texture}
    return {"file": f"{name}.obj", "texture": f"{name}.png", **entry}, files


def _drawn(group: tuple[Surface, ...], material: Material) -> tuple[Any, Any, Any, bytes | None]:
    """Vertices, triangles, texture coordinates and picture: as they are, or reduced."""
    vertices, faces = whole(group)
    textured = material.texture is not None and all(surface.uv is not None for surface in group)
    if len(faces) > MOST_DRAWN and (fewer := coarser((vertices, faces), _TRIED, LIMIT_MM)) is not None:
        if not textured:
            return (*fewer, None, None)
        uv, picture = rebaked(group, fewer)
        return (*fewer, uv, picture)
    if not textured:
        return vertices, faces, None, None
    starts = np.cumsum([0, *(len(surface.vertices) for surface in group[:-1])])
    apart = np.concatenate([surface.faces + start for surface, start in zip(group, starts, strict=True)])
    points = np.concatenate([surface.vertices for surface in group])
    return points, apart, np.concatenate([surface.uv for surface in group if surface.uv is not None]), material.texture
