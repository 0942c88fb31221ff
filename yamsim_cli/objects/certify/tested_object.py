"""Data of an object under test, and scenes with it alone or on a slab."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.scene import FixedCamera, Light
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.loft import Surface, concatenate_surfaces, weld_vertices
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.cameras import add_camera, fixed_camera
from yamsim_cli.core.scene.compilation import compile_spec
from yamsim_cli.core.scene.objects.scene_object import add_object
from yamsim_cli.core.sim.geom_shapes import body_surface, geom_corners

_GROUND_FRICTION = (1.0, 0.005, 0.0001)  # MuJoCo's, as of the table in configs/scenes/tabletop.yaml
_GROUND_HALF_SIZE = (1.0, 1.0, 0.05)  # m; thick, so that no object falls through
_TIMESTEP = 0.002  # s
_BACKGROUND = (0.80, 0.81, 0.82)


@dataclass(frozen=True)
class TestedObject:
    """An object under test.

    Attributes:
        meshes: mesh set -> folder, or None if missing.
        locations: config folders, with the rig that tests the grasp.
        visual_surfaces: of the base, vertices merged, in the object's frame, m; empty if a set is missing.
        collision_points: (n, 3) on the base's collision geoms, in the object's frame, m.
    """

    item: ObjectConfig
    meshes: Mapping[str, Path | None]
    locations: Locations
    visual_surfaces: tuple[Surface, ...]
    collision_points: Array

    @property
    def merged_visual_surface(self) -> Surface:
        """The visual surfaces as one."""
        return concatenate_surfaces(self.visual_surfaces)

    @property
    def surface_points(self) -> Array:
        """Points (n, 3) on visual surfaces, or on collision geoms if meshes are missing, m."""
        return self.merged_visual_surface[0] if self.visual_surfaces else self.collision_points

    @property
    def bounding_diagonal(self) -> float:
        """Bounding box diagonal of the collision geoms, m."""
        return float(np.linalg.norm(np.ptp(self.collision_points, axis=0)))


def read_tested_object(item: ObjectConfig, meshes: Mapping[str, Path | None], locations: Locations) -> TestedObject:
    """Compile an object's config, and return the data for the checks.

    Raises:
        ResourceError: a mesh cannot be read, or a collision mesh is missing.
        UsageError: the object is cloth.
    """
    if item.cloth is not None:
        raise UsageError(f"{item.name} is cloth, and only rigid objects can be certified; give another object")
    model = compile_or_raise(object_spec(item, meshes))
    looks, points = [], []
    here = all(meshes.get(name) is not None for name in item.mesh_sets)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != model.body(item.name).id:
            continue
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            points.append(geom_corners(model, geom))
        elif here and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH and "_look" in model.geom(geom).name:
            looks.append(weld_vertices(*body_surface(model, [geom])))
    return TestedObject(item, meshes, locations, tuple(looks), np.concatenate(points))


def object_spec(item: ObjectConfig, meshes: Mapping[str, Path | None], *, fixed: bool = False) -> mujoco.MjSpec:
    """Return a scene with the object alone; its base cannot move if `fixed`."""
    spec = mujoco.MjSpec()
    spec.compiler.autolimits = True
    spec.compiler.balanceinertia = True  # impossible inertias must compile, and fail `check_inertia`
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = _TIMESTEP
    add_object(spec, item, meshes, fixed=fixed)
    for mesh in spec.meshes:
        if "collide" not in mesh.name:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return spec


def object_on_ground_spec(tested_object: TestedObject) -> mujoco.MjSpec:
    """Return a scene with the object and a slab whose top is z = 0."""
    spec = object_spec(tested_object.item, tested_object.meshes)
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=_GROUND_HALF_SIZE,
        pos=[0, 0, -_GROUND_HALF_SIZE[2]],
        friction=_GROUND_FRICTION,
        condim=4,
        rgba=[0.62, 0.58, 0.53, 1],
    )
    return spec


def add_view_camera(
    spec: mujoco.MjSpec, centre: Sequence[float] | Array, size: float, steep: float = 0.75
) -> mujoco.MjSpec:
    """Add lights, and a camera `view` that shows `size` (m) around `centre` (3,), m.

    Args:
        steep: the camera's height over `centre`, as a share of 1.75 `size`.
    """
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    light = Light(direction=(-0.35, 0.30, -1), diffuse=(0.6, 0.6, 0.6))
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=light.direction, diffuse=light.diffuse, castshadow=True
    )
    spec.add_texture(
        name="certificate_sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_BACKGROUND, rgb2=_BACKGROUND, width=16, height=16,
    )  # fmt: skip
    x, y, z = (float(v) for v in centre)
    away = max(1.75 * size, 0.05)
    eye = (x + 0.62 * away, y - 0.62 * away, z + steep * away)
    add_camera(spec, fixed_camera("view", FixedCamera(position=eye, look_at=(x, y, z), fovy_deg=40)))
    spec.stat.extent = max(3 * size, 0.1)
    spec.stat.center = (x, y, z)
    spec.visual.map.znear = 0.005
    return spec


def compile_or_raise(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec; `ResourceError` if that fails."""
    return compile_spec(spec, "the thing", ResourceError)


def step_seconds(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    """Step physics for a duration, s."""
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
