"""What is seen of a thing's part: meshes, each with its own material and texture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco

from ...assets.store import is_own
from ...config.things.parts import ObjectMesh
from ..robot import mesh_bytes

# Asset set -> folder of its files, or the files themselves: name -> content; None where they are not here.
MeshFiles = Mapping[str, Path | Mapping[str, bytes] | None]

SEEN_GROUP = 2
HIDDEN_GROUP = 3


def set_file(folder: Path | Mapping[str, bytes], name: str) -> bytes:
    """A file of a set. Raises as `mesh_bytes`."""
    return mesh_bytes(folder / name) if isinstance(folder, Path) else folder[name]


def add_material(spec: mujoco.MjSpec, name: str, mesh: ObjectMesh, meshes: MeshFiles) -> str:
    """Add the material of a mesh, and give its name; its texture only where the mesh itself is shown."""
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
    """Add a mesh that is seen as geom `<name>_look`; nothing where its set is not here."""
    folder = meshes.get(mesh.set)
    if folder is None:
        return
    file = f"meshes/{mesh.set}/{mesh.file}"
    spec.assets = {**spec.assets, file: set_file(folder, mesh.file)}
    added = spec.add_mesh(name=name, file=file, refpos=mesh.origin)
    if is_own(mesh.set):
        # A surface from elsewhere need not enclose anything, and nothing is made of what it would weigh.
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
