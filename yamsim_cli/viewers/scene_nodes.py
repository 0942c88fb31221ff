"""Adds a compiled scene to a page of viser: a frame with geoms for each body, and a mesh for each cloth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from ..core.geometry.se3 import Array

_FIRST_HIDDEN_GROUP = 3  # of geoms in MuJoCo's viewer; holds the collision primitives
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default; any other colour overrides the material
_IMAGE_IN_PLANE = (0.0, 1.0, 0.0, 0.0)  # quaternion wxyz; y points down in viser's images, and up in MuJoCo's planes

# Transparent, so that the meshes inside collision primitives stay visible.
_COLLISION_PAINT = {"color": (230, 120, 30), "opacity": 0.6}

Paint = dict[str, Any]


@dataclass(frozen=True)
class BodyNodes:
    """Nodes of a scene's bodies in viser.

    Attributes:
        frames: body -> frame in `world`, for bodies with geoms. Frames start at the origin.
        visuals: parent nodes of the visible geoms, one for each body except the world body.
        colliders: parent nodes of the collision primitives, one for each body; hidden at first.
    """

    frames: dict[int, viser.FrameHandle]
    visuals: tuple[viser.FrameHandle, ...]
    colliders: tuple[viser.FrameHandle, ...]


def add_bodies(scene: viser.SceneApi, model: mujoco.MjModel) -> BodyNodes:
    """Add all geoms of a model to a page."""
    frames: dict[int, viser.FrameHandle] = {}
    groups: dict[tuple[int, bool], viser.FrameHandle] = {}
    for geom in range(model.ngeom):
        body, hidden = int(model.geom_bodyid[geom]), bool(model.geom_group[geom] >= _FIRST_HIDDEN_GROUP)
        path = f"/{model.body(body).name}"
        group = f"{path}/{'collision' if hidden else 'look'}"
        if body not in frames:
            frames[body] = scene.add_frame(path, show_axes=False)
        if (body, hidden) not in groups:
            groups[body, hidden] = scene.add_frame(group, show_axes=False, visible=not hidden)
        paint = _COLLISION_PAINT if hidden else {"color": _geom_colour(model, geom)}
        _add_geom(scene, model, geom, f"{group}/{model.geom(geom).name or geom}", paint)
    return BodyNodes(
        frames,
        tuple(node for (body, hidden), node in groups.items() if not hidden and body),
        tuple(node for (_, hidden), node in groups.items() if hidden),
    )


def _geom_colour(model: mujoco.MjModel, geom: int) -> tuple[int, int, int]:
    rgba, material = model.geom_rgba[geom], model.geom_matid[geom]
    if material >= 0 and np.allclose(rgba, _DEFAULT_RGBA):
        rgba = model.mat_rgba[material]
    return _rgb_integers(255 * rgba)


def _rgb_integers(colour: Array) -> tuple[int, int, int]:
    red, green, blue = (round(float(part)) for part in colour[:3])
    return red, green, blue


def _add_geom(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint) -> None:
    placed = {"position": model.geom_pos[geom], "wxyz": model.geom_quat[geom]}
    size = model.geom_size[geom]
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_MESH | mujoco.mjtGeom.mjGEOM_SDF:
            _add_mesh(scene, model, geom, name, paint, placed)
        case mujoco.mjtGeom.mjGEOM_PLANE:
            _add_plane(scene, model, geom, name, placed)
        case mujoco.mjtGeom.mjGEOM_BOX:
            scene.add_box(name, **paint, dimensions=tuple(2 * size), **placed)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            scene.add_icosphere(name, size[0], **paint, **placed)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            ball = trimesh.creation.icosphere()
            scene.add_mesh_simple(name, ball.vertices * size, ball.faces, **paint, **placed)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            scene.add_cylinder(name, size[0], 2 * size[1], **paint, **placed)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            scene.add_cylinder(name, size[0], 2 * size[1], **paint, **placed)
            for end, z in (("bottom", -size[1]), ("top", size[1])):
                scene.add_icosphere(f"{name}/{end}", size[0], position=(0.0, 0.0, z), **paint)


def _add_mesh(
    scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, paint: Paint, placed: dict[str, Any]
) -> None:
    mesh = model.geom_dataid[geom]
    if "opacity" not in paint and (textured := textured_mesh(model, geom)) is not None:
        scene.add_mesh_trimesh(name, textured, **placed)
        return
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    # Smooth shading would make the edges of machined parts look round.
    scene.add_mesh_simple(name, model.mesh_vert[vertices], model.mesh_face[faces], flat_shading=True, **paint, **placed)


def textured_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return the mesh of a geom with the texture of its material, if any."""
    from PIL import Image

    mesh, material = int(model.geom_dataid[geom]), int(model.geom_matid[geom])
    texture = _texture_of(model, material)
    if texture < 0 or model.mesh_texcoordadr[mesh] < 0:
        return None
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    coordinates = model.mesh_texcoord[model.mesh_texcoordadr[mesh] :][: model.mesh_texcoordnum[mesh]]
    # Merge corners with the same vertex and texture coordinates. Normals are then continuous over edges, as in MuJoCo.
    corners = np.stack(
        [model.mesh_face[first : first + count], model.mesh_facetexcoord[first : first + count]], axis=-1
    )
    pairs, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    uv = coordinates[pairs[:, 1]] * model.mat_texrepeat[material]
    material_of: Any = trimesh.visual.material.PBRMaterial
    pbr = material_of(
        baseColorTexture=Image.fromarray(_texture_pixels(model, texture)),
        baseColorFactor=np.rint(255 * model.mat_rgba[material]).astype(np.uint8),
        metallicFactor=0.0,
        roughnessFactor=0.7,
    )
    # MuJoCo measures v from the upper edge of the texture, and the glTF writer from the lower edge.
    visual_of: Any = trimesh.visual.TextureVisuals
    visual = visual_of(uv=np.column_stack([uv[:, 0], 1 - uv[:, 1]]), material=pbr)
    return trimesh.Trimesh(vertices[pairs[:, 0]], index.reshape(-1, 3), visual=visual, process=False)


def _add_plane(scene: viser.SceneApi, model: mujoco.MjModel, geom: int, name: str, placed: dict[str, Any]) -> None:
    """Add a printed board if the texture covers the plane once, or a floor if it repeats."""
    material = int(model.geom_matid[geom])
    texture = _texture_of(model, material)
    width, height = 2 * model.geom_size[geom, :2]
    if texture >= 0 and not model.mat_texuniform[material]:
        wxyz = np.empty(4)
        mujoco.mju_mulQuat(wxyz, model.geom_quat[geom], np.array(_IMAGE_IN_PLANE))
        pixels, turned = _texture_pixels(model, texture), placed | {"wxyz": wxyz}
        # PNG, since the edges of markers must stay sharp.
        scene.add_image(name, pixels, width, height, format="png", cast_shadow=False, **turned)
        return
    image = _texture_pixels(model, texture) if texture >= 0 else 255 * np.array([[model.geom_rgba[geom, :3]]])
    darkest = image.min(axis=(0, 1))
    scene.add_grid(
        name,
        width,
        height,
        cell_size=0.1,
        cell_color=_rgb_integers(darkest),
        section_color=_rgb_integers(darkest * 0.9),
        plane_color=_rgb_integers(image.mean(axis=(0, 1))),
        plane_opacity=1.0,
        **placed,
    )


def _texture_of(model: mujoco.MjModel, material: int) -> int:
    return int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1


def _texture_pixels(model: mujoco.MjModel, texture: int) -> Array:
    """Return the pixels (height, width, channels), uint8, of a texture, top row first."""
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    start = model.tex_adr[texture]
    pixels: Array = model.tex_data[start : start + np.prod(shape)].reshape(shape)
    return pixels


class ClothNodes:
    """Shows cloths on a page, each in the mean colour of its texture. All points start at the origin.

    Attributes:
        nodes: nodes of the cloths.
    """

    def __init__(self, scene: viser.SceneApi, model: mujoco.MjModel) -> None:
        self._points = [
            slice(first, first + n) for first, n in zip(model.flex_vertadr, model.flex_vertnum, strict=True)
        ]
        self.nodes = [
            scene.add_mesh_simple(
                f"/cloth/{mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, k)}",
                np.zeros((int(model.flex_vertnum[k]), 3)),
                model.flex_elem[model.flex_elemdataadr[k] :][: 3 * model.flex_elemnum[k]].reshape(-1, 3),
                color=_cloth_colour(model, int(model.flex_matid[k])),
                side="double",
            )
            for k in range(model.nflex)
        ]

    def set_points(self, points: Array) -> None:
        """Set the positions of all points (nflexvert, 3) in `world`, m. viser sends changes only."""
        for node, own in zip(self.nodes, self._points, strict=True):
            node.vertices = points[own].astype(np.float32)

    def remove(self) -> None:
        """Remove the cloths from the page."""
        for node in self.nodes:
            node.remove()


def _cloth_colour(model: mujoco.MjModel, material: int) -> tuple[int, int, int]:
    texture = _texture_of(model, material)
    return _rgb_integers(
        _texture_pixels(model, texture).mean(axis=(0, 1)) if texture >= 0 else 255 * model.mat_rgba[material]
    )
