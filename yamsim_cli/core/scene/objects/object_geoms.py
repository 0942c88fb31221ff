from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...config.objects.object_part import Contact, ObjectMesh
from ...config.objects.primitives import (
    Box,
    Capsule,
    CollisionPart,
    Cylinder,
    HullPart,
    Primitive,
    Ring,
    SdfPart,
    Sphere,
)
from ...errors import ResourceError
from ...geometry.se3 import Array, pose, quat_from_rotation, rotation_z
from ...geometry.stl import encode_stl
from ..arm_model import read_mesh_file
from ..assets.asset_store import is_user_set

# Asset set -> folder of its files, or the files themselves (name -> content); None if the set is not available.
MeshFiles = Mapping[str, Path | Mapping[str, bytes] | None]

VISIBLE_GROUP = 2  # of visible geoms
HIDDEN_GROUP = 3  # of collision geoms with a visual mesh
_SDF_OCTREE_DEPTH = 6  # octree depth of a signed distance field
_SOLMIX = 20.0  # weight of a geom with its own solref in contacts; other geoms have 1


def read_asset_file(folder: Path | Mapping[str, bytes], name: str) -> bytes:
    """Return the content of a file of an asset set, or raise `ResourceError`."""
    return read_mesh_file(folder / name) if isinstance(folder, Path) else folder[name]


def add_material(spec: mujoco.MjSpec, name: str, mesh: ObjectMesh, meshes: MeshFiles) -> str:
    """Add the material of a mesh, with its texture if `meshes` has the mesh's asset set, and return `name`."""
    material = spec.add_material(name=name, rgba=mesh.rgba, specular=mesh.specular, shininess=mesh.shininess)
    folder = meshes.get(mesh.set)
    if mesh.texture is not None and folder is not None:
        file = f"meshes/{mesh.set}/{mesh.texture}"
        if file not in spec.assets:
            spec.assets = {**spec.assets, file: read_asset_file(folder, mesh.texture)}
            spec.add_texture(name=file, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = file
    return name


def add_visual_mesh(
    spec: mujoco.MjSpec, body: Any, name: str, mesh: ObjectMesh, material: str, meshes: MeshFiles
) -> None:
    """Add a visual mesh as geom `<name>_look` if `meshes` has the mesh's asset set."""
    folder = meshes.get(mesh.set)
    if folder is None:
        return
    file = f"meshes/{mesh.set}/{mesh.file}"
    spec.assets = {**spec.assets, file: read_asset_file(folder, mesh.file)}
    added = spec.add_mesh(name=name, file=file, refpos=mesh.origin)
    if is_user_set(mesh.set):
        # Imported surfaces may be open. Their mass is not used.
        added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    body.add_geom(
        name=f"{name}_look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=added.name,
        material=material,
        group=VISIBLE_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
        castshadow=mesh.castshadow,
    )


def add_collision(
    spec: mujoco.MjSpec,
    body: Any,
    name: str,
    part: CollisionPart,
    contact: Contact,
    material: str,
    files: tuple[str, MeshFiles],
    *,
    hidden: bool,
) -> None:
    """Add one collision part of an object to a body: a primitive, a convex hull or a signed distance field.

    A missing collision mesh raises ResourceError: no other shape would have the same physics.

    Args:
        files: name of the asset set with the mesh file, and the folders of all sets.
        hidden: whether a visual mesh is shown instead.
    """
    if not isinstance(part, HullPart | SdfPart):
        add_primitive(body, name, part, contact, material, hidden=hidden)
        return
    set_name, meshes = files
    folder = meshes.get(set_name)
    if folder is None:
        raise ResourceError(
            f"the mesh set {set_name}, the collision geometry of {body.name}, is missing: import the object again as "
            "the comment in its config says, or copy the folder of that name from where it was made"
        )
    file = f"meshes/{set_name}/{part.file}"
    spec.assets = {**spec.assets, file: read_asset_file(folder, part.file)}
    mesh = spec.add_mesh(name=name, file=file, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    kind = mujoco.mjtGeom.mjGEOM_MESH
    if isinstance(part, SdfPart):
        kind, mesh.octree_maxdepth = mujoco.mjtGeom.mjGEOM_SDF, _SDF_OCTREE_DEPTH
    body.add_geom(
        name=name,
        type=kind,
        meshname=name,
        mass=0,
        group=HIDDEN_GROUP if hidden else VISIBLE_GROUP,
        material=material,
        **contact_attributes(contact),
    )


def contact_attributes(contact: Contact) -> dict[str, Any]:
    """Return the contact attributes of a geom for MuJoCo's `add_geom`."""
    numbers: dict[str, Any] = {"friction": contact.friction, "condim": contact.condim}
    if contact.push_out_s != Contact().push_out_s:
        # MuJoCo averages the solref of both geoms. The large solmix lets this geom's solref dominate.
        numbers |= {"solref": (contact.push_out_s, 1.0), "solmix": _SOLMIX}
    return numbers


def add_primitive(
    body: Any, name: str, part: Primitive, contact: Contact | None, material: str, *, hidden: bool
) -> None:
    """Add a primitive geom to a body (a ring as several boxes); without `contact`, the geom is only visual."""
    common: dict[str, Any] = {"mass": 0, "group": HIDDEN_GROUP if hidden else VISIBLE_GROUP}
    common |= {"rgba": part.rgba} if part.rgba else {"material": material}
    if contact is None:
        common |= {"contype": 0, "conaffinity": 0}
    else:
        common |= contact_attributes(contact)
    match part:
        case Capsule():
            kind, size = mujoco.mjtGeom.mjGEOM_CAPSULE, [part.radius, 0, 0]
            body.add_geom(name=name, type=kind, fromto=[*part.start, *part.end], size=size, **common)
        case Cylinder():
            kind, size = mujoco.mjtGeom.mjGEOM_CYLINDER, [part.radius, part.half_height, 0]
            body.add_geom(name=name, type=kind, pos=part.centre, size=size, **common)
        case Sphere():
            kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, [part.radius, 0, 0]
            body.add_geom(name=name, type=kind, pos=part.centre, size=size, **common)
        case Box():
            kind, quat = mujoco.mjtGeom.mjGEOM_BOX, quat_from_rotation(rotation_z(math.radians(part.yaw_deg)))
            body.add_geom(name=name, type=kind, pos=part.centre, quat=quat, size=part.half_size, **common)
        case Ring():
            for k in range(part.segments):
                body.add_geom(name=f"{name}_{k}", type=mujoco.mjtGeom.mjGEOM_BOX, **_ring_box(part, k), **common)


def add_visual_ring(spec: mujoco.MjSpec, body: Any, name: str, ring: Ring, material: str) -> None:
    """Add a ring, a sloping rim around z, as one visual mesh, which renders faster than dozens of boxes."""
    file = f"meshes/objects/{name}.stl"
    spec.assets = {**spec.assets, file: encode_stl(*_ring_surface(ring))}
    spec.add_mesh(name=name, file=file)
    colour: dict[str, Any] = {"rgba": ring.rgba} if ring.rgba else {"material": material}
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        group=VISIBLE_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
        **colour,
    )


def _ring_surface(ring: Ring) -> tuple[Array, NDArray[np.int32]]:
    inner, outer = np.array(ring.inner), np.array(ring.outer)
    along = (outer - inner) / np.linalg.norm(outer - inner)
    down = ring.thickness * np.array([along[1], -along[0]])
    section = np.array([inner, inner + down, outer + down, outer])
    angle = 2 * np.pi * np.arange(ring.segments) / ring.segments
    x, y = (np.outer(turn, section[:, 0]) for turn in (np.cos(angle), np.sin(angle)))
    vertices = np.stack([x, y, np.broadcast_to(section[:, 1], x.shape)], axis=-1).reshape(-1, 3)
    index = np.arange(4 * ring.segments, dtype=np.int32).reshape(-1, 4)
    right, up = np.roll(index, -1, axis=1), np.roll(index, -1, axis=0)
    diagonal = np.roll(right, -1, axis=0)
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((index, up, right), (right, up, diagonal))])
    return vertices, faces


def _ring_box(ring: Ring, k: int) -> dict[str, Any]:
    """Return position, quaternion and half-size of box k of a ring. Boxes meet at the corners of their wider edge."""
    (r0, z0), (r1, z1) = ring.inner, ring.outer
    run, rise = r1 - r0, z1 - z0
    length = math.hypot(run, rise)
    slope = math.atan2(rise, run)
    width = 2 * max(r0, r1) * math.tan(math.pi / ring.segments)
    # Box axes: x up the slope, y along the rim, z out of the upper surface.
    c, s = math.cos(slope), math.sin(slope)
    tilted = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    centre = np.array([(r0 + r1) / 2, 0, (z0 + z1) / 2]) - tilted[:, 2] * ring.thickness / 2
    turn = rotation_z(2 * math.pi * k / ring.segments)
    T = pose(turn @ centre, turn @ tilted)
    return {"pos": T[:3, 3], "quat": quat_from_rotation(T[:3, :3]), "size": [length / 2, width / 2, ring.thickness / 2]}
