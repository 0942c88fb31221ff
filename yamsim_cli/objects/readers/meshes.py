"""Read surfaces and materials of glTF, OBJ, STL, PLY and COLLADA by trimesh, which opens no files itself."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.untrusted.confined_folder import ConfinedFolder
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.stl import Faces, decode_stl, is_binary_stl

from .mesh_headers import check_header
from .object_parts import GREY, Rgba, Surface, SurfaceMaterial
from .textures import bake_vertex_colours, encode_png_texture, open_image

MAX_FACES = 2_000_000  # triangles; no scan needs more

# Ending -> trimesh's file type, unit (m), up axis; None if the format defines none.
MESH_FORMATS: dict[str, tuple[str, float | None, str | None]] = {
    # Source: glTF 2.0 specification, section 3.4: metres, +Y up.
    ".glb": ("glb", 1.0, "y"),
    ".gltf": ("gltf", 1.0, "y"),
    ".obj": ("obj", None, None),
    ".stl": ("stl", None, None),
    ".ply": ("ply", None, None),
    # Each file states both.
    ".dae": ("dae", None, None),
}

# Image files that materials may name; only PNG and JPEG are accepted.
_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".gif", ".webp", ".dds", ".exr", ".hdr")


@dataclass(frozen=True)
class MeshFile:
    """Surfaces in the file's unit; the unit, m, and up axis, if stated."""

    surfaces: tuple[Surface, ...]
    unit_m: float | None
    up: str | None


class _Resolver:
    """Gives trimesh the named files that lie in a confined folder."""

    def __init__(self, folder: ConfinedFolder, base: Path) -> None:
        self._folder, self._base = folder, base

    def get(self, name: str) -> bytes:
        data = self._folder.read(name, self._base)
        if Path(name).suffix.lower() in _PICTURE_SUFFIXES:
            # trimesh ignores images that it cannot open.
            try:
                open_image(data, name)
            except RefusedError as error:
                self._folder.refused = error
                raise
        return data

    __getitem__ = get

    def namespaced(self, namespace: str) -> _Resolver:
        return self

    def keys(self) -> list[str]:
        return []

    def __contains__(self, name: str) -> bool:
        return False


def read_mesh(data: bytes, suffix: str, folder: ConfinedFolder, base: Path) -> MeshFile:
    """Return a mesh file's surfaces.

    Args:
        suffix: decides the format.
        folder: contains all files that the mesh may name.
        base: the file's folder, below `folder`.

    Raises:
        RefusedError: the file is damaged or too large, or names a file outside `folder`.
    """
    if suffix not in MESH_FORMATS:
        raise RefusedError(
            "unknown-kind", f"{suffix or 'no suffix'} is not supported; valid: {', '.join(MESH_FORMATS)}"
        )
    check_header(data, suffix, MAX_FACES)
    kind, unit, up = MESH_FORMATS[suffix]
    if suffix == ".stl" and is_binary_stl(data):
        return MeshFile((_binary_stl(data),), unit, up)
    try:
        import trimesh
    except ImportError:
        raise RefusedError("unknown-kind", "a text STL needs trimesh: run `pip install 'yamsim[import]'`") from None
    if suffix == ".dae":
        from .untrusted_xml import collada_asset

        unit, up = collada_asset(data)
    try:
        resolver: Any = _Resolver(folder, base)
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=kind, resolver=resolver, process=False, allow_remote=False
        )
        meshes = _placed_meshes(scene)
    except RefusedError:
        raise
    except MemoryError:
        raise RefusedError("too-much-memory", "reading it takes too much memory for a file of its size") from None
    # trimesh can raise almost any exception on a damaged file.
    except Exception as error:
        raise folder.refused or _damaged_file_error(suffix, error) from error
    if folder.refused is not None:
        raise folder.refused
    if suffix in (".glb", ".gltf"):
        _check_textures(data, suffix, meshes)
    surfaces = tuple(surface for mesh, T in meshes if (surface := _surface_from_mesh(mesh, T)) is not None)
    if not surfaces:
        raise RefusedError("empty", "it has no triangles")
    if sum(len(surface.faces) for surface in surfaces) > MAX_FACES:
        raise RefusedError("too-many-faces", f"it has more than {MAX_FACES:,} faces: reduce it first")
    return MeshFile(surfaces, unit, up)


def _binary_stl(data: bytes) -> Surface:
    try:
        vertices, faces = decode_stl(data)
    except ResourceError as error:
        raise RefusedError("no-numbers", "it has coordinates that are not finite numbers") from error
    if not len(faces):
        raise RefusedError("empty", "it has no triangles")
    return Surface(vertices, faces)


def _damaged_file_error(suffix: str, error: Exception) -> RefusedError:
    reason = " ".join(str(error).split())[:120]
    return RefusedError("damaged", f"it cannot be read as {suffix[1:].upper()} ({type(error).__name__}: {reason})")


def _placed_meshes(scene: Any) -> list[tuple[Any, Array]]:
    import trimesh

    found, faces = [], 0
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            faces += len(mesh.faces)
            # A small file can use one mesh a million times.
            if faces > MAX_FACES:
                raise RefusedError("too-many-faces", f"it has more than {MAX_FACES:,} faces: reduce it first")
            found.append((mesh, np.asarray(T, np.float64)))
    return found


def _surface_from_mesh(mesh: Any, T: Array) -> Surface | None:
    vertices = np.asarray(mesh.vertices, np.float64)
    faces = np.asarray(mesh.faces, np.int64)
    if not np.isfinite(vertices).all() or not np.isfinite(T).all():
        raise RefusedError("no-numbers", "it has coordinates that are not finite numbers")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise RefusedError("damaged", "it has triangles with vertices that do not exist")
    triangles: Faces = faces.astype(np.int32)
    material, uv, colours = GREY, None, None
    texture = None
    visual = mesh.visual
    if visual.kind == "texture":
        material, image = _colour_and_texture(visual.material)
        if image is not None and visual.uv is not None and len(visual.uv) == len(vertices):
            corners = np.asarray(visual.uv, np.float64)[triangles]
            if not np.isfinite(corners).all():
                raise RefusedError("no-numbers", "it has texture coordinates that are not finite numbers")
            uv, texture = corners, encode_png_texture(image, "of a material")
        colour = visual.vertex_attributes.get("color") if uv is None and hasattr(visual, "vertex_attributes") else None
        if colour is not None and len(colour) == len(vertices):
            colours = _colour_bytes(np.asarray(colour))
    elif visual.kind == "vertex":
        colours = np.asarray(visual.vertex_colors, np.uint8)
    elif visual.kind == "face":
        # Triangles get separate corners.
        colours = np.repeat(np.asarray(visual.face_colors, np.uint8), 3, axis=0)
        vertices = vertices[triangles].reshape(-1, 3)
        triangles = np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)
    if colours is not None and (colours == colours[0]).all():
        material, colours = _clipped_rgba(colours[0] / 255), None
    if colours is not None:
        uv, texture = bake_vertex_colours(vertices, triangles, colours)
        material = (1.0, 1.0, 1.0, 1.0)
    return Surface(vertices, triangles, SurfaceMaterial(material, texture), uv).transform(T)


def _colour_and_texture(material: Any) -> tuple[Rgba, Any]:
    from trimesh.visual.material import PBRMaterial

    if isinstance(material, PBRMaterial):
        factor, image = material.baseColorFactor, material.baseColorTexture
    else:
        factor, image = getattr(material, "diffuse", None), getattr(material, "image", None)
        if image is not None:
            # In OBJ and COLLADA a texture replaces the colour, an arbitrary grey of exporters.
            return (1.0, 1.0, 1.0, 1.0), image
    if factor is None:
        return ((1.0, 1.0, 1.0, 1.0) if image is not None else GREY), image
    return _clipped_rgba(_colour_bytes(np.asarray(factor).ravel()) / 255), image


def _colour_bytes(colours: Any) -> Any:
    if np.issubdtype(colours.dtype, np.floating):
        colours = np.clip(np.nan_to_num(colours), 0, 1) * 255
    colours = np.clip(colours, 0, 255).astype(np.uint8)
    if colours.shape[-1] == 3:
        colours = np.concatenate([colours, np.full((*colours.shape[:-1], 1), 255, np.uint8)], axis=-1)
    return colours


def _clipped_rgba(values: Any) -> Rgba:
    red, green, blue, alpha = (round(min(1.0, max(0.0, float(v))), 4) for v in (*values, 1.0)[:4])
    return red, green, blue, alpha


def _check_textures(data: bytes, suffix: str, meshes: list[tuple[Any, Array]]) -> None:
    text = data if suffix == ".gltf" else data[20 : 20 + int.from_bytes(data[12:16], "little")]
    tree = json.loads(text)
    named = {
        material.get("name")
        for material in tree.get("materials", [])
        if "baseColorTexture" in (material.get("pbrMetallicRoughness") or {})
    }
    for mesh, _ in meshes:
        material = getattr(mesh.visual, "material", None)
        if (
            material is not None
            and getattr(material, "name", None) in named
            and getattr(material, "baseColorTexture", None) is None
        ):
            raise RefusedError("texture-unreadable", f"the texture of material {material.name!r} cannot be read")


def mesh_surfaces(
    folder: ConfinedFolder, uri: str, base: Path, scale: Sequence[float], material: SurfaceMaterial | None
) -> list[Surface]:
    """Return the scaled surfaces (m) of a mesh that an SDF or URDF file names, with any `material`.

    As in simulators, the mesh file's up axis is ignored.
    """
    if not uri:
        raise RefusedError("damaged", "it has a mesh without a name")
    if not all(1e-6 <= abs(factor) <= 1e6 for factor in scale):
        raise RefusedError(
            "impossible", f"it scales a mesh by {' '.join(f'{factor:g}' for factor in scale)}; valid: 1e-6 to 1e6"
        )
    path = folder.find(uri, base)
    mesh = read_mesh(folder.read(uri, base), path.suffix.lower(), folder, path.parent)
    T = np.diag([*(np.array(scale) * (mesh.unit_m or 1.0)), 1.0])
    surfaces = [surface.transform(T) for surface in mesh.surfaces]
    if material is None:
        return surfaces
    return [_with_material(surface, material) for surface in surfaces]


def _with_material(surface: Surface, material: SurfaceMaterial) -> Surface:
    if material.texture is None and surface.material.texture is not None:
        return surface
    return replace(surface, material=material)


def make_material(folder: ConfinedFolder, rgba: Sequence[float], texture: str, base: Path) -> SurfaceMaterial:
    """Return a material with a colour and the texture `texture`, if it names an image."""
    red, green, blue, alpha = (min(1.0, max(0.0, value)) for value in (*rgba, 1.0, 1.0, 1.0, 1.0)[:4])
    colour: Rgba = (red, green, blue, alpha if len(rgba) > 3 else 1.0)
    if not texture:
        return SurfaceMaterial(colour)
    return SurfaceMaterial(colour, encode_png_texture(open_image(folder.read(texture, base), texture), texture))
