"""Objects in a scene: primitives carry the contacts, a scan is only seen."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.objects import Contact, ObjectConfig
from ..config.primitives import Box, Capsule, Cylinder, Primitive, Ring, Sphere
from ..geometry.se3 import Array, pose, quat_from_rotation, rotation_z
from ..geometry.stl import stl_bytes
from .robot import mesh_bytes

SEEN_GROUP = 2
HIDDEN_GROUP = 3


def add_object(spec: mujoco.MjSpec, item: ObjectConfig, meshes: Path | None, *, fixed: bool = False) -> None:
    """Add a free body named after the object.

    Args:
        meshes: folder with the scans; None shows the collision primitives instead, with the same physics.
        fixed: rather one that stands where it is put.
    """
    body = spec.worldbody.add_body(name=item.name, mocap=fixed)
    if not fixed:
        body.add_freejoint(name=item.name)
    body.mass, body.ipos = item.inertia.mass, item.inertia.centre
    body.inertia = item.inertia.diagonal
    body.iquat = np.asarray(item.inertia.quat) / np.linalg.norm(item.inertia.quat)
    body.explicitinertial = True

    material = spec.add_material(
        name=item.name, rgba=item.mesh.rgba, specular=item.mesh.specular, shininess=item.mesh.shininess
    )
    for k, part in enumerate(item.collision):
        _add_primitive(body, f"{item.name}_collide_{k}", part, item.contact, material.name, hidden=meshes is not None)
    for k, part in enumerate(item.look):
        name = f"{item.name}_look_{k}"
        if isinstance(part, Ring):
            _add_seen_ring(spec, body, name, part, material.name)
        else:
            _add_primitive(body, name, part, None, material.name, hidden=False)
    if meshes is not None:
        file = f"meshes/{item.mesh.set}/{item.mesh.file}"
        spec.assets = {**spec.assets, file: mesh_bytes(meshes / item.mesh.file)}
        mesh = spec.add_mesh(name=item.name, file=file, refpos=item.mesh.origin)
        body.add_geom(
            name=f"{item.name}_look",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            material=material.name,
            group=SEEN_GROUP,
            contype=0,
            conaffinity=0,
            mass=0,
            castshadow=item.mesh.castshadow,
        )


def _add_primitive(
    body: Any, name: str, part: Primitive, contact: Contact | None, material: str, *, hidden: bool
) -> None:
    common: dict[str, Any] = {"mass": 0, "group": HIDDEN_GROUP if hidden else SEEN_GROUP}
    common |= {"rgba": part.rgba} if part.rgba else {"material": material}
    if contact is None:
        common |= {"contype": 0, "conaffinity": 0}
    else:
        common |= {"friction": contact.friction, "condim": contact.condim}
    match part:
        case Capsule():
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[*part.start, *part.end],
                size=[part.radius, 0, 0],
                **common,
            )
        case Cylinder():
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=part.centre,
                size=[part.radius, part.half_height, 0],
                **common,
            )
        case Sphere():
            body.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=part.centre, size=[part.radius, 0, 0], **common
            )
        case Box():
            turn = rotation_z(math.radians(part.yaw_deg))
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=part.centre,
                quat=quat_from_rotation(turn),
                size=part.half_size,
                **common,
            )
        case Ring():
            for k in range(part.segments):
                body.add_geom(name=f"{name}_{k}", type=mujoco.mjtGeom.mjGEOM_BOX, **_ring_box(part, k), **common)


def _add_seen_ring(spec: mujoco.MjSpec, body: Any, name: str, ring: Ring, material: str) -> None:
    """A ring that is only seen, as one mesh: dozens of boxes would be as many things to draw."""
    file = f"meshes/objects/{name}.stl"
    spec.assets = {**spec.assets, file: stl_bytes(*_ring_surface(ring))}
    spec.add_mesh(name=name, file=file)
    colour: dict[str, Any] = {"rgba": ring.rgba} if ring.rgba else {"material": material}
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        group=SEEN_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
        **colour,
    )


def _ring_surface(ring: Ring) -> tuple[Array, NDArray[np.int32]]:
    """A closed surface around the z axis: vertices (4 n, 3) in m, and triangles (8 n, 3)."""
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
    """Position, quaternion and half-size of one box of a ring; boxes meet at the outer edge's corners."""
    (r0, z0), (r1, z1) = ring.inner, ring.outer
    run, rise = r1 - r0, z1 - z0
    length = math.hypot(run, rise)
    slope = math.atan2(rise, run)
    width = 2 * r1 * math.tan(math.pi / ring.segments)
    # Box axes: x up the slope, y along the rim, z out of the upper surface.
    c, s = math.cos(slope), math.sin(slope)
    tilted = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    centre = np.array([(r0 + r1) / 2, 0, (z0 + z1) / 2]) - tilted[:, 2] * ring.thickness / 2
    turn = rotation_z(2 * math.pi * k / ring.segments)
    T = pose(turn @ centre, turn @ tilted)
    return {"pos": T[:3, 3], "quat": quat_from_rotation(T[:3, :3]), "size": [length / 2, width / 2, ring.thickness / 2]}
