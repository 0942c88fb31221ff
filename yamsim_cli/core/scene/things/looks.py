"""Visual meshes of objects, with material and texture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco

from ...assets.own_sets import is_own
from ...config.things.parts import ObjectMesh
from ..robot import mesh_bytes

# Asset set -> folder of its files, or the files themselves (name -> content); None if the set is not here.
MeshFiles = Mapping[str, Path | Mapping[str, bytes] | None]

SEEN_GROUP = 2
HIDDEN_GROUP = 3


def set_file(folder: Path | Mapping[str, bytes], name: str) -> bytes:
    """The content of a file of a set. Raises as `mesh_bytes`."""
    return mesh_bytes(folder / name) if isinstance(folder, Path) else folder[name]


def add_material(spec: mujoco.MjSpec, name: str, mesh: ObjectMesh, meshes: MeshFiles) -> str:
    """Add the material of a mesh, with its texture if the mesh is shown, and return the name."""
    material = spec.add_material(name=name, rgba=mesh.rgba, specular=mesh.specular, shininess=mesh.shininess)
    folder = meshes.get(mesh.set)
    if mesh.texture is not None and folder is not None:
        file = f"meshes/{mesh.set}/{mesh.texture}"
        if file not in spec.assets:
            spec.assets = {**spec.assets, file: set_file(folder, mesh.texture)}
            spec.add_texture(name=file, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = file
    return name


def add_look(spec: mujoco.MjSpec, body: Any, name: str, mesh: ObjectMesh, material: str, meshes: MeshFiles) -> None:
    """Add a visual mesh as geom `<name>_look`, if its set is here."""
    folder = meshes.get(mesh.set)
    if folder is None:
        return
    file = f"meshes/{mesh.set}/{mesh.file}"
    spec.assets = {**spec.assets, file: set_file(folder, mesh.file)}
    added = spec.add_mesh(name=name, file=file, refpos=mesh.origin)
    if is_own(mesh.set):
        # Imported surfaces need not be closed, and their mass is not used.
        added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    body.add_geom(
        name=f"{name}_look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=added.name,
        material=material,
        group=SEEN_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
        castshadow=mesh.castshadow,
    )
