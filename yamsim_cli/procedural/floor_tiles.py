"""The mesh of a tiled floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def checkerboard_mesh(half_floor: float, tile: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return every second tile of a floor: vertices (4 n, 3), m, and triangles (2 n, 3) that face up.

    Args:
        half_floor: half the edge of the floor, m.
        tile: edge of a tile, m.
    """
    row, column = np.meshgrid(*2 * [np.arange(round(2 * half_floor / tile))], indexing="ij")
    low = np.stack([row, column], axis=-1)[(row + column) % 2 == 0] * tile - half_floor
    square = tile * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    flat = (low[:, None] + square).reshape(-1, 2)
    corner = 4 * np.arange(len(low), dtype=np.int32)[:, None, None]
    halves = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return np.pad(flat, ((0, 0), (0, 1))), (corner + halves).reshape(-1, 3)
