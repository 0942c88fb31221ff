"""Adds a compiled scene to a viser page: a frame for each body, with the body's geoms fixed in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from ..geometry.se3 import Array

# Groups below this are shown, as in MuJoCo's own viewer. Collision primitives behind meshes are in group 3.
_SEEN_GROUPS = 3

# MuJoCo's default colour of a geom. Any other colour of a geom overrides its material's.
_NO_RGBA = (0.5, 0.5, 0.5, 1.0)

# Quaternion of an image in a plane: viser's images have y pointing down the picture, MuJoCo's planes up.
_IMAGE_IN_PLANE = (0.0, 1.0, 0.0, 0.0)

# Collision primitives are transparent, so that what they stand for is seen behind them.
_COLLISION_PAINT = {"color": (230, 120, 30), "opacity": 0.6}

Paint = dict[str, Any]
Mjt = mujoco.mjtGeom


@dataclass(frozen=True)
class BodyNodes:
    """A page's nodes.

    Attributes:
        frames: body -> its frame in `world`, for bodies with geoms. Frames start at the origin.
        looks: parent nodes of the visible geoms, one per body, without those of the world itself.
        colliders: parent nodes of collision primitives behind visible geoms, one per body; hidden at first.
    """

    frames: dict[int, viser.FrameHandle]
    looks: tuple[viser.FrameHandle, ...]
    colliders: tuple[viser.FrameHandle, ...]


def add_bodies(scene: viser.SceneApi, model: mujoco.MjModel) -> BodyNodes:
    """The nodes of a model, all of whose geoms are added to a page."""
    frames: dict[int, viser.FrameHandle] = {}
    groups: dict[tuple[int, bool], viser.FrameHandle] = {}
    for geom in range(model.ngeom):
        body, hidden = int(model.geom_bodyid[geom]), bool(model.geom_group[geom] >= _SEEN_GROUPS)
        path = f"/{model.body(body).name}"
        group = f"{path}/{'collision' if hidden else 'look'}"
        if body not in frames:
            frames[body] = scene.add_frame(path, show_axes=False)
        if (body, hidden) not in groups:
            groups[body, hidden] = scene.add_frame(group, show_axes=False, visible=not hidden)
        paint = _COLLISION_PAINT if hidden else {"color": _colour(model, geom)}
        _ADDERS[Mjt(model.geom_type[geom])](scene, model, geom, f"{group}/{model.geom(geom).name or geom}", paint)
    return BodyNodes(
        frames,
        tuple(node for (body, hidden), node in groups.items() if not hidden and body),
        tuple(node for (_, hidden), node in groups.items() if hidden),
    )


def _placed(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    return {"position": model.geom_pos[geom], "wxyz": model.geom_quat[geom]}


def _colour(model: mujoco.MjModel, geom: int) -> tuple[int, int, int]:
    rgba, material = model.geom_rgba[geom], model.geom_matid[geom]
    if material >= 0 and np.allclose(rgba, _NO_RGBA):
        rgba = model.mat_rgba[material]
    return _rgb(rgba)


def _rgb(colour: Array) -> tuple[int, int, int]:
    """A colour of 0 to 1 in viser's range of 0 to 255."""
    red, green, blue = (round(255 * float(part)) for part in colour[:3])
    return red, green, blue


def _add_mesh(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    mesh = model.geom_dataid[geom]
    if "opacity" not in paint and (printed := _printed(model, geom)) is not None:
        scene.add_mesh_trimesh(name, printed, **_placed(model, geom))
        return
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    scene.add_mesh_simple(
        name,
        model.mesh_vert[vertices],
        model.mesh_face[faces],
        # Smooth shading would round off every edge of a machined part.
        flat_shading=True,
        **paint,
        **_placed(model, geom),
    )


def _printed(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """A mesh with its material's picture; None where it has none."""
    from PIL import Image

    mesh, material = int(model.geom_dataid[geom]), int(model.geom_matid[geom])
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1
    if texture < 0 or model.mesh_texcoordadr[mesh] < 0:
        return None
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    coordinates = model.mesh_texcoord[model.mesh_texcoordadr[mesh] :][: model.mesh_texcoordnum[mesh]]
    # Corners that share a place and a spot of the picture are one: normals then go on over edges as they do in MuJoCo.
    corners = np.stack(
        [model.mesh_face[first : first + count], model.mesh_facetexcoord[first : first + count]], axis=-1
    )
    pairs, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    uv = coordinates[pairs[:, 1]] * model.mat_texrepeat[material]
    material_of: Any = trimesh.visual.material.PBRMaterial
    look = material_of(
        baseColorTexture=Image.fromarray(_texture(model, texture)),
        baseColorFactor=np.rint(255 * model.mat_rgba[material]).astype(np.uint8),
        metallicFactor=0.0,
        roughnessFactor=0.7,
    )
    # MuJoCo tells places in a picture from its upper edge, glTF's writer from its lower one.
    visual_of: Any = trimesh.visual.TextureVisuals
    visual = visual_of(uv=np.column_stack([uv[:, 0], 1 - uv[:, 1]]), material=look)
    return trimesh.Trimesh(vertices[pairs[:, 0]], index.reshape(-1, 3), visual=visual, process=False)


def _add_plane(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    """Add a plane: a printed board if its texture covers it once, or a floor if its texture repeats."""
    material = model.geom_matid[geom]
    texture = model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB] if material >= 0 else -1
    width, height = 2 * model.geom_size[geom, :2]
    if texture >= 0 and not model.mat_texuniform[material]:
        position, wxyz = model.geom_pos[geom], np.empty(4)
        mujoco.mju_mulQuat(wxyz, model.geom_quat[geom], np.array(_IMAGE_IN_PLANE))
        # As PNG, since a marker's edges must stay sharp.
        scene.add_image(
            name,
            _texture(model, texture),
            width,
            height,
            format="png",
            cast_shadow=False,
            position=position,
            wxyz=wxyz,
        )
        return
    image = _texture(model, texture) / 255 if texture >= 0 else np.array([[model.geom_rgba[geom, :3]]])
    scene.add_grid(
        name,
        width,
        height,
        cell_size=0.1,
        cell_color=_rgb(image.min(axis=(0, 1))),
        section_color=_rgb(image.min(axis=(0, 1)) * 0.9),
        plane_color=_rgb(image.mean(axis=(0, 1))),
        plane_opacity=1.0,
        **_placed(model, geom),
    )


def _texture(model: mujoco.MjModel, texture: int) -> Array:
    """A texture's pixels (height, width, channels) uint8, first row on top."""
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    start = model.tex_adr[texture]
    pixels: Array = model.tex_data[start : start + np.prod(shape)].reshape(shape)
    return pixels


def _add_box(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    size = tuple(2 * model.geom_size[geom])
    scene.add_box(name, **paint, dimensions=size, **_placed(model, geom))


def _add_sphere(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    scene.add_icosphere(name, model.geom_size[geom, 0], **paint, **_placed(model, geom))


def _add_cylinder(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    radius, half = model.geom_size[geom, :2]
    scene.add_cylinder(name, radius, 2 * half, **paint, **_placed(model, geom))


def _add_capsule(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    radius, half = model.geom_size[geom, :2]
    _add_cylinder(scene, model, geom, name, paint)
    for end, z in (("bottom", -half), ("top", half)):
        scene.add_icosphere(f"{name}/{end}", radius, position=(0.0, 0.0, z), **paint)


_ADDERS: dict[mujoco.mjtGeom, Callable[[viser.SceneApi, mujoco.MjModel, int, str, Paint], None]] = {
    Mjt.mjGEOM_PLANE: _add_plane,
    Mjt.mjGEOM_SPHERE: _add_sphere,
    Mjt.mjGEOM_CAPSULE: _add_capsule,
    Mjt.mjGEOM_CYLINDER: _add_cylinder,
    Mjt.mjGEOM_BOX: _add_box,
    Mjt.mjGEOM_MESH: _add_mesh,
}
