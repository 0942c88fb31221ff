"""Meshes and colours that description files refer to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..untrusted.jail import Folder
from ..untrusted.refusals import RefusedError
from .meshes import read_mesh
from .parts import Material, Rgba, Surface
from .textures import open_image, png_of


def mesh_surfaces(
    folder: Folder, uri: str, base: Path, scale: Sequence[float], material: Material | None
) -> list[Surface]:
    """A mesh that a description names, in metres as it lies in the file, with another material if one is given.

    Which axis is up in the mesh file counts for nothing here, as with the simulators that these files are made for.
    """
    if not uri:
        raise RefusedError("damaged", "it has a mesh without a name")
    if not all(1e-6 <= abs(factor) <= 1e6 for factor in scale):
        raise RefusedError("impossible", f"it scales a mesh by {' '.join(f'{factor:g}' for factor in scale)}")
    path = folder.find(uri, base)
    mesh = read_mesh(folder.read(uri, base), path.suffix.lower(), folder, path.parent)
    T = np.diag([*(np.array(scale) * (mesh.unit_m or 1.0)), 1.0])
    surfaces = [surface.moved(T) for surface in mesh.surfaces]
    if material is None:
        return surfaces
    return [_painted(surface, material) for surface in surfaces]


def _painted(surface: Surface, material: Material) -> Surface:
    """A description's colour stands in place of the mesh's; without a picture of its own, the mesh's stays."""
    if material.texture is None and surface.material.texture is not None:
        return surface
    return replace(surface, material=material)


def plain_material(folder: Folder, rgba: Sequence[float], texture: str, base: Path) -> Material:
    """A material of a colour and, if named, a picture."""
    red, green, blue, alpha = (min(1.0, max(0.0, value)) for value in (*rgba, 1.0, 1.0, 1.0, 1.0)[:4])
    colour: Rgba = (red, green, blue, alpha if len(rgba) > 3 else 1.0)
    if not texture:
        return Material(colour)
    return Material(colour, png_of(open_image(folder.read(texture, base), texture), texture))
