"""Bodies with a known surface, and more faces than they need."""

from __future__ import annotations

import numpy as np

Surface = tuple[np.ndarray, np.ndarray]


def box(size: float = 1.0, cuts: int = 8) -> Surface:
    """A cube with one corner at the origin, each side cut into `cuts` x `cuts` squares; outward facing."""
    steps = np.linspace(0, size, cuts + 1)
    corners = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for i in range(cuts):
            for j in range(cuts):
                square = [steps[i + di] * u + steps[j + dj] * v for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))]
                far = [corner + size * np.eye(3)[axis] for corner in square]
                corners += [[far[k] for k in t] for t in ((0, 1, 2), (0, 2, 3))]
                corners += [[square[k] for k in t] for t in ((0, 2, 1), (0, 3, 2))]
    vertices, index = np.unique(np.array(corners).reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int32)


def ball(radius: float = 1.0, rings: int = 40) -> Surface:
    """A closed ball."""
    polar, around = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    x, y = (np.outer(np.sin(polar), turn(around)) for turn in (np.cos, np.sin))
    middle = np.stack([x, y, np.broadcast_to(np.cos(polar)[:, None], x.shape)], axis=-1).reshape(-1, 3)
    vertices = radius * np.concatenate([middle, [[0, 0, 1], [0, 0, -1]]])
    index = np.arange(len(middle)).reshape(rings - 1, -1)
    here, right = index, np.roll(index, -1, axis=1)
    top, bottom = np.full_like(index[0], len(middle)), np.full_like(index[0], len(middle) + 1)
    faces = [np.stack([here[:-1], here[1:], right[1:]], axis=-1), np.stack([here[:-1], right[1:], right[:-1]], axis=-1)]
    faces += [np.stack([top, here[0], right[0]], axis=-1), np.stack([bottom, right[-1], here[-1]], axis=-1)]
    return vertices, np.concatenate([part.reshape(-1, 3) for part in faces]).astype(np.int32)


def volume(surface: Surface) -> float:
    a, b, c = np.moveaxis(surface[0][surface[1]], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
