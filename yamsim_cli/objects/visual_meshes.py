"""Make a part's visual mesh files. Large surfaces are reduced, and their colours baked into a new texture."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import ResourceError
from ..core.files.writing import sha256_bytes
from ..core.geometry.se3 import Array
from ..core.geometry.stl import Faces, encode_stl
from ..core.images.png import decode_png, encode_png
from ..core.scene.assets.mesh_reduction import MAX_DEVIATION_MM
from .part_surfaces import merged_surface, simplified_mesh
from .readers.object_parts import Surface, SurfaceMaterial

_MAX_FACES = 20_000  # triangles that render fast; larger surfaces are reduced within LIMIT_MM
_FACE_COUNTS = (6_000, 12_000, 24_000, 48_000)  # triangles of a reduced surface, tried in order
_CELL_SIZE = 0.0006  # m, finest cells in which colours are averaged; each level doubles their side
_MAX_GRID_LEVELS = 6
_MAX_SIDE = 4096  # px, width of a baked texture
_TRIANGLE_TILE_RANGE = (2, 16)  # px, side of a triangle's square in a texture


@dataclass(frozen=True)
class VisualMeshes:
    """A part's visual meshes: config entries without `set`, and file name -> content."""

    meshes: tuple[Mapping[str, Any], ...]
    files: Mapping[str, bytes]


def make_visual_meshes(name: str, surfaces: tuple[Surface, ...]) -> VisualMeshes:
    """Make one mesh per material, OBJ and PNG if textured, else STL; `name` begins file names."""
    groups: dict[tuple[Any, ...], list[Surface]] = {}
    for surface in surfaces:
        material = surface.material
        picture = material.texture and sha256_bytes(material.texture)
        key = (picture, material.rgba, material.specular, material.shininess)
        groups.setdefault(key, []).append(surface)
    meshes: list[Mapping[str, Any]] = []
    files: dict[str, bytes] = {}
    for number, group in enumerate(groups.values()):
        mesh, made = _mesh_entry(f"{name}_{number}", tuple(group))
        meshes.append(mesh)
        files |= made
    return VisualMeshes(tuple(meshes), files)


def _mesh_entry(name: str, group: tuple[Surface, ...]) -> tuple[dict[str, Any], dict[str, bytes]]:
    material = group[0].material
    entry: dict[str, Any] = {
        "rgba": [round(part, 4) for part in material.rgba],
        "specular": round(material.specular, 3),
        "shininess": round(material.shininess, 3),
    }
    vertices, faces, uv, texture = _mesh_arrays(group, material)
    if uv is None or texture is None:
        return {"file": f"{name}.stl", **entry}, {f"{name}.stl": encode_stl(vertices, faces)}
    files = {f"{name}.obj": obj_bytes(vertices, faces, uv), f"{name}.png": texture}
    return {"file": f"{name}.obj", "texture": f"{name}.png", **entry}, files


def _mesh_arrays(group: tuple[Surface, ...], material: SurfaceMaterial) -> tuple[Any, Any, Any, bytes | None]:
    """Merge surfaces of one material, reduced above `_MAX_FACES`; uv (m, 3, 2) and PNG are None without a texture."""
    vertices, faces = merged_surface(group)
    textured = material.texture is not None and all(surface.uv is not None for surface in group)
    if (
        len(faces) > _MAX_FACES
        and (fewer := simplified_mesh((vertices, faces), _FACE_COUNTS, MAX_DEVIATION_MM)) is not None
    ):
        if not textured:
            return (*fewer, None, None)
        return (*fewer, *bake_surface_colours(group, fewer))
    if not textured:
        return vertices, faces, None, None
    starts = np.cumsum([0, *(len(surface.vertices) for surface in group[:-1])])
    apart = np.concatenate([surface.faces + start for surface, start in zip(group, starts, strict=True)])
    points = np.concatenate([surface.vertices for surface in group])
    return points, apart, np.concatenate([surface.uv for surface in group if surface.uv is not None]), material.texture


def obj_bytes(vertices: ArrayLike, faces: Faces, uv: ArrayLike) -> bytes:
    """Return a deterministic Wavefront OBJ of triangles (m, 3) over vertices (n, 3).

    `uv` (m, 3, 2) are texture coordinates of triangle corners, from the image's lower left.
    """
    coordinates, index = np.unique(np.asarray(uv, np.float64).reshape(-1, 2).round(6), axis=0, return_inverse=True)
    text = io.StringIO()
    np.savetxt(text, np.asarray(vertices), fmt="v %.7g %.7g %.7g")
    np.savetxt(text, coordinates, fmt="vt %.6g %.6g")
    corners = np.stack([np.asarray(faces), index.reshape(-1, 3)], axis=-1) + 1
    np.savetxt(text, corners.reshape(-1, 6), fmt="f %d/%d %d/%d %d/%d")
    return text.getvalue().encode()


def bake_surface_colours(source: Sequence[Surface], target: tuple[Array, Faces]) -> tuple[Array, bytes]:
    """Return uv (m, 3, 2) and a PNG that give a mesh the colours of nearby textured surfaces.

    Args:
        target: vertices (n, 3), m, and triangles (m, 3).
    """
    vertices, faces = target
    colours = _ColourCells(*_sample_colours(source))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    columns = int(np.ceil(np.sqrt(len(faces))))
    tile = int(np.clip(np.ceil(np.sqrt(2 * area / len(faces)) / _CELL_SIZE), *_TRIANGLE_TILE_RANGE))
    tile = max(2, min(tile, _MAX_SIDE // columns))
    rows = -(-len(faces) // columns)
    x, y = tile * (np.arange(len(faces)) % columns), tile * (np.arange(len(faces)) // columns)
    texels = np.zeros((rows * tile, columns * tile, 3), np.uint8)
    for v in range(tile):
        for u in range(tile):
            # The triangle fills half of its tile; the other half repeats the long side's colours.
            s, t = u / (tile - 1), v / (tile - 1)
            texels[y + v, x + u] = colours.mean_colours(
                a + s * (b - a) + t * (c - a) if s + t <= 1 else b + (1 - s) * (c - b)
            )
    ends = np.array([[0, 0], [tile - 1, 0], [0, tile - 1]])
    uv = (np.stack([x, y], axis=1)[:, None] + ends + 0.5) / [texels.shape[1], texels.shape[0]]
    uv[..., 1] = 1 - uv[..., 1]
    return uv, encode_png(texels)


def _sample_colours(source: Sequence[Surface]) -> tuple[Array, NDArray[np.uint8]]:
    places, found = [], []
    rng = np.random.default_rng(0)
    for surface in source:
        a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        count = int(np.clip(4 * areas.sum() / _CELL_SIZE**2, len(areas), 3_000_000))
        drawn = np.concatenate([np.arange(len(areas)), rng.choice(len(areas), count, p=areas / areas.sum())])
        root, v = np.sqrt(rng.random((len(drawn), 1))), rng.random((len(drawn), 1))
        shares = np.concatenate([1 - root, root * (1 - v), root * v], axis=1)
        places.append(np.einsum("ik,ikj->ij", shares, surface.vertices[surface.faces[drawn]]))
        assert surface.uv is not None and surface.material.texture is not None
        uv = np.einsum("ik,ikj->ij", shares, surface.uv[drawn])
        found.append(_texture_colours(surface.material.texture, uv))
    return np.concatenate(places), np.concatenate(found)


def _texture_colours(texture: bytes, uv: Array) -> NDArray[np.uint8]:
    image = decode_png(texture)
    if image is None:
        raise ResourceError("a texture of the object cannot be decoded")
    height, width = image.shape[:2]
    columns = np.floor((uv[:, 0] % 1.0) * width).astype(int).clip(0, width - 1)
    rows = np.floor(((1 - uv[:, 1]) % 1.0) * height).astype(int).clip(0, height - 1)
    picked: NDArray[np.uint8] = image[rows, columns]
    return picked


class _ColourCells:
    """Mean colours in cubic cells of several sizes, by position."""

    def __init__(self, places: Array, colours: NDArray[np.uint8]) -> None:
        self._low = places.min(axis=0) - 1e-3
        self._levels = []
        for level in range(_MAX_GRID_LEVELS):
            keys = self._cell_keys(places, level)
            found, index = np.unique(keys, return_inverse=True)
            sums = np.stack([np.bincount(index, colours[:, k].astype(float)) for k in range(3)], axis=1)
            self._levels.append((found, sums / np.bincount(index)[:, None]))

    def _cell_keys(self, places: Array, level: int) -> NDArray[np.int64]:
        cells = np.floor((places - self._low) / (_CELL_SIZE * 2**level)).astype(np.int64)
        keys: NDArray[np.int64] = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
        return keys

    def mean_colours(self, places: Array) -> NDArray[np.uint8]:
        colours = np.full((len(places), 3), 128.0)
        for level in reversed(range(_MAX_GRID_LEVELS)):
            found, means = self._levels[level]
            keys = self._cell_keys(places, level)
            at = np.searchsorted(found, keys).clip(0, len(found) - 1)
            has = found[at] == keys
            colours[has] = means[at[has]]
        rounded: NDArray[np.uint8] = np.rint(colours).astype(np.uint8)
        return rounded
