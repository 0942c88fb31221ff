"""Decode textures within limits, store them as PNG, and bake vertex colours into textures."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.stl import Faces

_MAX_PIXELS = 64_000_000
_MAX_SIDE = 2048  # px, of a stored texture
_TRIANGLE_TILE_PX = 2  # px, a triangle's square: one texel per corner, a fourth for interpolation


def open_image(data: bytes, name: str) -> Any:
    """Open a PNG or JPEG without decoding it. Raises `RefusedError` if unreadable or too large."""
    from PIL import Image, UnidentifiedImageError

    Image.MAX_IMAGE_PIXELS = _MAX_PIXELS
    try:
        return _check_pixel_count(Image.open(io.BytesIO(data), formats=("PNG", "JPEG")), name)
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        raise RefusedError("texture-unreadable", f"the texture {name} is not a PNG or JPEG") from error
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise RefusedError("texture-too-large", f"the texture {name} is too large to be decoded: {error}") from error


def _check_pixel_count(image: Any, name: str) -> Any:
    width, height = image.size
    if width * height > _MAX_PIXELS:
        raise RefusedError(
            "texture-too-large",
            f"the texture {name} has {width} x {height} pixels; at most {_MAX_PIXELS // 10**6} million: reduce "
            f"it to a width of {_MAX_SIDE}, the most that is rendered",
        )
    return image


def encode_png_texture(image: Any, name: str) -> bytes:
    """Encode as RGB PNG of at most 2048 x 2048 pixels. Raises `RefusedError` if undecodable."""
    _check_pixel_count(image, name)
    try:
        if "transparency" in image.info or image.mode in ("RGBA", "LA", "PA"):
            image = image.convert("RGBA")
        image = image.convert("RGB")
        image.thumbnail((_MAX_SIDE, _MAX_SIDE))
        out = io.BytesIO()
        image.save(out, format="PNG", compress_level=6)
    except (OSError, ValueError, SyntaxError) as error:
        raise RefusedError("texture-unreadable", f"the texture {name} cannot be decoded: {error}") from error
    return out.getvalue()


def bake_vertex_colours(vertices: Array, faces: Faces, colours: NDArray[np.uint8]) -> tuple[Array, bytes]:
    """Return texture coordinates (m, 3, 2) and a PNG of vertex colours (n, 4), interpolated over triangles.

    Each triangle has a tile. Tiles of neighbours are close together, so that a smaller texture blends similar colours.
    """
    from PIL import Image

    columns = max(1, int(np.ceil(np.sqrt(len(faces)))))
    rows = -(-len(faces) // columns)
    place = np.empty(len(faces), np.int64)
    place[_morton_order(vertices[faces].mean(axis=1))] = np.arange(len(faces))
    x, y = _TRIANGLE_TILE_PX * (place % columns), _TRIANGLE_TILE_PX * (place // columns)
    corner = colours[faces][..., :3].astype(np.int64)
    texels = np.zeros((_TRIANGLE_TILE_PX * rows, _TRIANGLE_TILE_PX * columns, 3), np.uint8)
    texels[y, x], texels[y, x + 1], texels[y + 1, x] = corner[:, 0], corner[:, 1], corner[:, 2]
    texels[y + 1, x + 1] = np.clip(corner[:, 1] + corner[:, 2] - corner[:, 0], 0, 255)
    centres = np.stack([np.stack([x, y], 1), np.stack([x + 1, y], 1), np.stack([x, y + 1], 1)], axis=1) + 0.5
    uv = centres / [texels.shape[1], texels.shape[0]]
    uv[..., 1] = 1 - uv[..., 1]
    out = io.BytesIO()
    Image.fromarray(texels).save(out, format="PNG", compress_level=6)
    return uv, out.getvalue()


def _morton_order(points: Array) -> NDArray[np.int64]:
    """Return indices (n,) of points (n, 3) in Morton order, which keeps neighbours together."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * 1023).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
