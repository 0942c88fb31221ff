"""The colours of a surface on another one that lies beside it: a picture in which each triangle has a tile."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import ResourceError
from ..geometry.se3 import Array
from ..geometry.stl import Faces
from ..images.png import decode_png, encode_png
from ..thing_files.parts import Surface

# How finely colours are looked up, m; what has no colour so near takes one from twice as far, and so on.
_CELL = 0.0006
_COARSER = 6
_SIDE = 4096
_TILES = (2, 16)


def rebaked(source: Sequence[Surface], target: tuple[Array, Faces]) -> tuple[Array, bytes]:
    """Texture coordinates (m, 3, 2) and a PNG for the target's triangles (m, 3), with the source's colours."""
    vertices, faces = target
    colours = _Colours(*_samples(source))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    columns = int(np.ceil(np.sqrt(len(faces))))
    tile = int(np.clip(np.ceil(np.sqrt(2 * area / len(faces)) / _CELL), *_TILES))
    tile = max(2, min(tile, _SIDE // columns))
    rows = -(-len(faces) // columns)
    x, y = tile * (np.arange(len(faces)) % columns), tile * (np.arange(len(faces)) // columns)
    texels = np.zeros((rows * tile, columns * tile, 3), np.uint8)
    for v in range(tile):
        for u in range(tile):
            # Beyond the triangle's long side colours go on as they would: what is drawn between texels needs them.
            s, t = u / (tile - 1), v / (tile - 1)
            texels[y + v, x + u] = colours.at(a + s * (b - a) + t * (c - a) if s + t <= 1 else b + (1 - s) * (c - b))
    ends = np.array([[0, 0], [tile - 1, 0], [0, tile - 1]])
    uv = (np.stack([x, y], axis=1)[:, None] + ends + 0.5) / [texels.shape[1], texels.shape[0]]
    uv[..., 1] = 1 - uv[..., 1]
    return uv, encode_png(texels)


def _samples(source: Sequence[Surface]) -> tuple[Array, NDArray[np.uint8]]:
    """Places all over the surfaces (n, 3), m, and the colours there (n, 3)."""
    places, found = [], []
    rng = np.random.default_rng(0)
    for surface in source:
        a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        count = int(np.clip(4 * areas.sum() / _CELL**2, len(areas), 3_000_000))
        drawn = np.concatenate([np.arange(len(areas)), rng.choice(len(areas), count, p=areas / areas.sum())])
        root, v = np.sqrt(rng.random((len(drawn), 1))), rng.random((len(drawn), 1))
        shares = np.concatenate([1 - root, root * (1 - v), root * v], axis=1)
        places.append(np.einsum("ik,ikj->ij", shares, surface.vertices[surface.faces[drawn]]))
        assert surface.uv is not None and surface.material.texture is not None  # the caller's choice
        uv = np.einsum("ik,ikj->ij", shares, surface.uv[drawn])
        found.append(_looked_up(surface.material.texture, uv))
    return np.concatenate(places), np.concatenate(found)


def _looked_up(texture: bytes, uv: Array) -> NDArray[np.uint8]:
    image = decode_png(texture)
    if image is None:
        raise ResourceError("a texture of the thing cannot be decoded")
    height, width = image.shape[:2]
    columns = np.floor((uv[:, 0] % 1.0) * width).astype(int).clip(0, width - 1)
    rows = np.floor(((1 - uv[:, 1]) % 1.0) * height).astype(int).clip(0, height - 1)
    picked: NDArray[np.uint8] = image[rows, columns]
    return picked


class _Colours:
    """Mean colours of cells of space, finer and coarser ones."""

    def __init__(self, places: Array, colours: NDArray[np.uint8]) -> None:
        self._low = places.min(axis=0) - 1e-3
        self._levels = []
        for level in range(_COARSER):
            keys = self._keys(places, level)
            found, index = np.unique(keys, return_inverse=True)
            sums = np.stack([np.bincount(index, colours[:, k].astype(float)) for k in range(3)], axis=1)
            self._levels.append((found, sums / np.bincount(index)[:, None]))

    def _keys(self, places: Array, level: int) -> NDArray[np.int64]:
        cells = np.floor((places - self._low) / (_CELL * 2**level)).astype(np.int64)
        keys: NDArray[np.int64] = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
        return keys

    def at(self, places: Array) -> NDArray[np.uint8]:
        """Colours (n, 3) of the finest cells around places (n, 3) that have any; grey where none has."""
        colours = np.full((len(places), 3), 128.0)
        for level in reversed(range(_COARSER)):
            found, means = self._levels[level]
            keys = self._keys(places, level)
            at = np.searchsorted(found, keys).clip(0, len(found) - 1)
            has = found[at] == keys
            colours[has] = means[at[has]]
        rounded: NDArray[np.uint8] = np.rint(colours).astype(np.uint8)
        return rounded
