from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ...config.objects.generated import GENERATED_SET, generated_mesh_files
from ...config.objects.object_config import ObjectConfig
from ...config.objects.object_part import Contact, Inertia, ObjectMesh
from ...config.objects.primitives import CollisionPart, Primitive, Ring
from ...geometry.se3 import quat_from_rotation
from ..cloth import add_cloth
from .object_geoms import MeshFiles, add_collision, add_material, add_primitive, add_visual_mesh, add_visual_ring
from .object_joints import add_handles, add_link_joint, link_start_pose

# An object with `base: fixed` has a free joint, so that each attempt can place it. With this armature (kg, kg m2) and
# damping (N s/m, N m s), no hand moves it by 0.1 mm in a minute.
_FIXED_ARMATURE, _FIXED_DAMPING = 1e4, 1e7


def add_object(spec: mujoco.MjSpec, item: ObjectConfig, meshes: MeshFiles, *, fixed: bool = False) -> None:
    """Add an object as a free body of the same name with its links, or add a cloth.

    Where visual `meshes` (asset set -> folder) are missing, the collision primitives are visible. If `fixed`, the
    object is a mocap body, which physics never moves.
    """
    if item.cloth is not None:
        assert not fixed, "distractors are stiff"
        add_cloth(spec, item)
        return
    if item.shape is not None:
        meshes = {**meshes, GENERATED_SET: generated_mesh_files(item.name, item.shape)}
    base = spec.worldbody.add_body(name=item.name, mocap=fixed)
    if item.base == "fixed" and not fixed:
        base.add_joint(
            name=item.name, type=mujoco.mjtJoint.mjJNT_FREE, armature=_FIXED_ARMATURE, damping=[_FIXED_DAMPING, 0, 0]
        )
        base.gravcomp = 1.0
    elif not fixed:
        base.add_freejoint(name=item.name)
    _fill_body(
        spec, base, item.name, item.inertia, item.contact, (item.mesh, *item.meshes), item.collision, item.look,
        (item.mesh.set, meshes),
    )  # fmt: skip
    add_handles(base, item.name, item.handles)
    bodies: dict[str | None, Any] = {None: base}
    for link in item.links:
        parent, name = bodies[link.parent], f"{item.name}_{link.name}"
        T = link_start_pose(link)
        body = parent.add_body(name=name, pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]))
        add_link_joint(spec, parent, body, name, link)
        _fill_body(
            spec, body, name, link.inertia, item.contact, link.meshes or (), link.collision, link.look,
            (item.mesh.set, meshes), plain=item.mesh,
        )  # fmt: skip
        add_handles(body, name, link.handles)
        bodies[link.name] = body


def _fill_body(
    spec: mujoco.MjSpec,
    body: Any,
    name: str,
    inertia: Inertia,
    contact: Contact,
    looks: Sequence[ObjectMesh],
    collision: Sequence[CollisionPart],
    look: Sequence[Primitive],
    files: tuple[str, MeshFiles],
    plain: ObjectMesh | None = None,
) -> None:
    """Add inertia, collision geoms, visual meshes (`looks`) and visual primitives (`look`) to a body.

    A body without meshes has the colour of `plain`. `files`: set of the collision meshes, and set -> files.
    """
    body.mass, body.ipos = inertia.mass, inertia.centre
    body.inertia = inertia.diagonal
    body.iquat = np.asarray(inertia.quat) / np.linalg.norm(inertia.quat)
    body.explicitinertial = True
    meshes = files[1]
    first = looks[0] if looks else plain
    assert first is not None  # a base has a mesh
    material = add_material(spec, name, first, meshes if looks else {})
    hidden = any(meshes.get(mesh.set) is not None for mesh in looks)
    for k, part in enumerate(collision):
        add_collision(spec, body, f"{name}_collide_{k}", part, contact, material, files, hidden=hidden)
    for k, seen in enumerate(look):
        part_name = f"{name}_look_{k}"
        if isinstance(seen, Ring):
            add_visual_ring(spec, body, part_name, seen, material)
        else:
            add_primitive(body, part_name, seen, None, material, hidden=False)
    for k, mesh in enumerate(looks):
        own = name if k == 0 else f"{name}_mesh_{k}"
        add_visual_mesh(spec, body, own, mesh, material if k == 0 else add_material(spec, own, mesh, meshes), meshes)
