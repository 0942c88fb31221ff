from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.rendering import SHADOW_REACH, RenderConfig
from ..config.scene import SceneConfig, Table
from ..geometry.se3 import Array
from ..geometry.stl import encode_stl
from .objects.object_geoms import VISIBLE_GROUP, contact_attributes

_HALF_FLOOR, _TILE = 5.0, 0.5  # m, half the edge of the floor, and the edge of a tile
_TILE_HEIGHT = 0.001  # m above the floor, sufficient for the depth buffer
_SHADOW_BOX_INSET = (
    0.003  # m, inset of the inner box that casts a box's shadow: about two texels of the default shadow map
)


def add_background(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add the sky and the tiled floor, which stops falling objects."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=scene.sky[1],
        rgb2=scene.sky[0],
        width=64,
        height=64,
    )
    for name, colour in zip(("floor", "floor_tiles"), scene.floor_rgba, strict=True):
        spec.add_material(name=name, rgba=(*colour, 1), specular=0.1, shininess=0.1)
    # No shadow: the floor could only shade itself falsely.
    spec.worldbody.add_geom(
        name="safety_plane",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0, 0, scene.safety_plane],
        size=[_HALF_FLOOR, _HALF_FLOOR, 0.1],
        material="floor",
        castshadow=False,
    )
    # The tiles are a mesh. Without a GPU, texture look-ups would take longer than the rest of the floor.
    file = "meshes/surroundings/floor_tiles.stl"
    spec.assets = {**spec.assets, file: encode_stl(*_checkerboard_mesh())}
    spec.add_mesh(name="floor_tiles", file=file, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    spec.worldbody.add_geom(
        name="floor_tiles",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="floor_tiles",
        pos=[0, 0, scene.safety_plane + _TILE_HEIGHT],
        material="floor_tiles",
        contype=0,
        conaffinity=0,
        mass=0,
        castshadow=False,
    )


def _checkerboard_mesh() -> tuple[Array, NDArray[np.int32]]:
    """Return every second tile of the floor: vertices (4 n, 3), m, and triangles (2 n, 3) that face up."""
    row, column = np.meshgrid(*2 * [np.arange(round(2 * _HALF_FLOOR / _TILE))], indexing="ij")
    low = np.stack([row, column], axis=-1)[(row + column) % 2 == 0] * _TILE - _HALF_FLOOR
    square = _TILE * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    flat = (low[:, None] + square).reshape(-1, 2)
    corner = 4 * np.arange(len(low), dtype=np.int32)[:, None, None]
    halves = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return np.pad(flat, ((0, 0), (0, 1))), (corner + halves).reshape(-1, 3)


def add_lights(spec: mujoco.MjSpec, scene: SceneConfig, centre: Sequence[float] | Array) -> None:
    """Add the scene's directional lights and the headlight; shadows are sharpest around `centre` (3,), in `world`."""
    headlight = spec.visual.headlight
    headlight.ambient = scene.ambient
    headlight.diffuse = (0.15, 0.15, 0.15)
    headlight.specular = (0, 0, 0)
    for k, light in enumerate(scene.lights):
        direction = np.asarray(light.direction) / np.linalg.norm(light.direction)
        spec.worldbody.add_light(
            name=f"light_{k}",
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            # A directional light's position only centres its shadow map.
            pos=np.asarray(centre) - direction,
            dir=direction,
            diffuse=light.diffuse,
            specular=light.specular,
            castshadow=light.castshadow,
        )


def add_table(spec: mujoco.MjSpec, table: Table, floor: float, bases: Sequence[Array]) -> None:
    """Add the table, its legs, and a post from each arm's base to the floor. Legs and posts have no contacts."""
    spec.add_material(name="table", rgba=table.rgba, specular=0.1, shininess=0.1, reflectance=table.reflectance)
    _add_box(spec, "table", table.position, table.half_size, contact_attributes(table.contact))
    x, y, _ = table.position
    half_x, half_y, half_z = table.half_size
    inset = 0.03
    bottom = table.top_height - 2 * half_z
    posts = [(x + i * (half_x - inset), y + j * (half_y - inset), bottom, 0.02) for i in (-1, 1) for j in (-1, 1)]
    # The posts end 1 mm below the bases. Coincident surfaces would flicker.
    posts += [(T[0, 3], T[1, 3], T[2, 3] - 0.001, 0.06) for T in bases]
    for k, (px, py, top, half) in enumerate(posts):
        height = top - floor
        _add_box(spec, f"post_{k}", (px, py, top - height / 2), (half, half, height / 2), {})


def _add_box(
    spec: mujoco.MjSpec, name: str, position: Sequence[float], half_size: Sequence[float], contact: Mapping[str, Any]
) -> None:
    """Add a box with a smaller box inside, which casts the shadow and avoids shadow acne.

    Without MuJoCo's `contact` parameters, the box has no contacts.
    """
    shared = {"type": mujoco.mjtGeom.mjGEOM_BOX, "pos": position, "group": VISIBLE_GROUP}
    nothing = {"contype": 0, "conaffinity": 0}
    spec.worldbody.add_geom(
        name=name, size=half_size, material="table", castshadow=False, **shared, **(contact or nothing)
    )
    core = np.maximum(np.asarray(half_size) - _SHADOW_BOX_INSET, np.asarray(half_size) / 4)
    # MuJoCo renders each box of a reflective material in a separate pass, so the core has no material.
    spec.worldbody.add_geom(name=f"{name}_core", size=core, **shared, **nothing)


def apply_quality(spec: mujoco.MjSpec, quality: RenderConfig, size: tuple[int, int]) -> None:
    """Set the render quality of a composed scene for images of `size` (width, height), px."""
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = quality.fine_size(size)
    visual.quality.offsamples = quality.multisamples
    visual.quality.shadowsize = quality.shadow_map_px
    # `compose` has set the shadow clip for the default reach.
    visual.map.shadowclip += quality.shadow_reach_m - SHADOW_REACH
    visual.quality.numslices, visual.quality.numstacks = quality.slices, quality.slices // 2
    for number, light in enumerate(spec.lights):
        light.castshadow = number < quality.shadow_lights
    if not quality.reflections:
        for material in spec.materials:
            material.reflectance = 0
