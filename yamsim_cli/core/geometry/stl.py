from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ResourceError
from .se3 import Array

Faces = NDArray[np.int32]

_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_HEADER = 80  # bytes


def encode_stl(vertices: ArrayLike, faces: ArrayLike) -> bytes:
    """Return a binary STL of vertices (n, 3) and triangles (m, 3); equal meshes give equal bytes."""
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(len(corners), dtype=_FACE)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    # The normal of a triangle without area is zero.
    records["normal"] = normals / np.where(lengths > 0, lengths, 1.0)
    records["corners"] = corners
    return bytes(_HEADER) + len(records).to_bytes(4, "little") + records.tobytes()


def is_binary_stl(data: bytes) -> bool:
    """Return whether the data's length matches its number of triangles, which must not be 0."""
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    return count > 0 and len(data) == _HEADER + 4 + count * _FACE.itemsize


def decode_stl(data: bytes) -> tuple[Array, Faces]:
    """Return the vertices (n, 3) of a binary STL, in the file's unit, and its triangles (m, 3), or raise ResourceError.

    Equal corners are merged. Triangles that thereby lose a corner are omitted.
    """
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    if not is_binary_stl(data):
        raise ResourceError(f"{len(data)} bytes are not a binary STL")
    corners = np.frombuffer(data, _FACE, count, _HEADER + 4)["corners"].astype(np.float64)
    if not np.isfinite(corners).all():
        raise ResourceError("an STL has coordinates that are not finite")
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int32)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return vertices, faces[whole]
