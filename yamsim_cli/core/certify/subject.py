"""The thing that is looked at: its config, the surfaces that are seen, and points on what touches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from ..config.scene import FixedCamera, Light
from ..config.things.thing import ObjectConfig
from ..errors import ResourceError, UsageError
from ..geometry.loft import Surface, joined, welded
from ..geometry.se3 import Array
from ..resources import Locations
from ..scene.cameras import add_camera, fixed_camera
from ..scene.compiling import compile_spec
from ..scene.things.thing import add_object
from ..sim.shapes import body_surface, geom_corners

# Of the slab that everything lies on: its surface is a table's in a scene (configs/scenes/tabletop.yaml), but it is
# thick: what a light thing does to a thin table top is not the thing's fault.
_GROUND_FRICTION = (1.0, 0.005, 0.0001)
_GROUND_HALF = (1.0, 1.0, 0.05)
_TIMESTEP = 0.002
# What is behind a thing in its pictures.
_PAPER = (0.80, 0.81, 0.82)


@dataclass(frozen=True)
class Subject:
    """A thing, and all that checks need to know of it.

    Attributes:
        meshes: asset set -> folder, None where it is not here.
        locations: where the hand's model is.
        looks: each mesh of the base as a closed surface (or not), welded, in the thing's frame; none where a set is
            not here.
        touching: points (n, 3) on the base's collision geoms, in the thing's frame, m.
    """

    item: ObjectConfig
    meshes: Mapping[str, Path | None]
    locations: Locations
    looks: tuple[Surface, ...]
    touching: Array

    @property
    def surface(self) -> Surface:
        """All that is seen of it as one."""
        return joined(self.looks)

    @property
    def shown(self) -> bool:
        """Whether its meshes are here."""
        return bool(self.looks)


def subject(item: ObjectConfig, meshes: Mapping[str, Path | None], locations: Locations) -> Subject:
    """Read a thing.

    Raises:
        ResourceError: a mesh cannot be read, or it collides by files that are not here.
        UsageError: it is cloth.
    """
    if item.cloth is not None:
        raise UsageError(f"{item.name} is cloth, and certificates are of stiff things; give another object")
    model = compiled(bare_spec(item, meshes))
    looks, touching = [], []
    here = all(meshes.get(name) is not None for name in item.mesh_sets)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != model.body(item.name).id:
            continue
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            touching.append(geom_corners(model, geom))
        elif here and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH and "_look" in model.geom(geom).name:
            looks.append(welded(*body_surface(model, [geom])))
    return Subject(item, meshes, locations, tuple(looks), np.concatenate(touching))


def bare_spec(item: ObjectConfig, meshes: Mapping[str, Path | None], *, fixed: bool = False) -> mujoco.MjSpec:
    """The thing alone, without ground."""
    spec = mujoco.MjSpec()
    spec.compiler.autolimits = True
    # What cannot be is for checks to say.
    spec.compiler.balanceinertia = True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = _TIMESTEP
    add_object(spec, item, meshes, fixed=fixed)
    for mesh in spec.meshes:
        if mesh.inertia != mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL and "collide" not in mesh.name:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return spec


def grounded_spec(looked: Subject) -> mujoco.MjSpec:
    """The thing and a slab under it, its top at z = 0."""
    spec = bare_spec(looked.item, looked.meshes)
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=_GROUND_HALF,
        pos=[0, 0, -_GROUND_HALF[2]],
        friction=_GROUND_FRICTION,
        condim=4,
        rgba=[0.62, 0.58, 0.53, 1],
    )
    return spec


def with_camera(
    spec: mujoco.MjSpec, centre: Sequence[float] | Array, size: float, steep: float = 0.75
) -> mujoco.MjSpec:
    """The same spec with lights, and a camera `view` that shows so much (m) around a place."""
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    light = Light(direction=(-0.35, 0.30, -1), diffuse=(0.6, 0.6, 0.6))
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=light.direction, diffuse=light.diffuse, castshadow=True
    )
    spec.add_texture(
        name="certificate_sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_PAPER, rgb2=_PAPER, width=16, height=16,
    )  # fmt: skip
    x, y, z = (float(v) for v in centre)
    away = max(1.75 * size, 0.05)
    eye = (x + 0.62 * away, y - 0.62 * away, z + steep * away)
    add_camera(spec, fixed_camera("view", FixedCamera(position=eye, look_at=(x, y, z), fovy_deg=40)))
    spec.stat.extent = max(3 * size, 0.1)
    spec.stat.center = (x, y, z)
    spec.visual.map.znear = 0.005
    return spec


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The compiled spec.

    Raises:
        ResourceError: MuJoCo refused it.
    """
    return compile_spec(spec, "the thing", ResourceError)
