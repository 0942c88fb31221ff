"""Wavefront OBJ: triangles with texture coordinates of their own corners."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import ArrayLike

from .stl import Faces


def obj_bytes(vertices: ArrayLike, faces: Faces, uv: ArrayLike) -> bytes:
    """An OBJ of triangles (m, 3) over vertices (n, 3), in the vertices' unit; equal meshes give equal bytes.

    Args:
        uv: texture coordinates (m, 3, 2) of each triangle's corners, from the picture's lower left corner.
    """
    coordinates, index = np.unique(np.asarray(uv, np.float64).reshape(-1, 2).round(6), axis=0, return_inverse=True)
    text = io.StringIO()
    np.savetxt(text, np.asarray(vertices), fmt="v %.7g %.7g %.7g")
    np.savetxt(text, coordinates, fmt="vt %.6g %.6g")
    corners = np.stack([np.asarray(faces), index.reshape(-1, 3)], axis=-1) + 1
    np.savetxt(text, corners.reshape(-1, 6), fmt="f %d/%d %d/%d %d/%d")
    return text.getvalue().encode()
