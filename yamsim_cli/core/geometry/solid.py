"""What closed surfaces hold: volume, centre and inertia of an even filling, and whether they are closed at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .se3 import Array
from .stl import Faces


@dataclass(frozen=True)
class Filling:
    """A body filled evenly.

    Attributes:
        volume: m3; negative where the surface is inside out.
        centre: of mass (3,), m.
        inertia: (3, 3) about the centre of mass of a body of density 1, kg m2.
    """

    volume: float
    centre: Array
    inertia: Array


def filling(vertices: Array, faces: Faces) -> Filling:
    """What a closed surface of vertices (n, 3), m, and triangles (m, 3) holds; what it overlaps counts twice."""
    middle = vertices.mean(axis=0)
    a, b, c = np.moveaxis((vertices - middle)[faces], 1, 0)
    # Tetrahedra from the middle to each triangle: their volumes, and their integrals of x and x x^T.
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    total = float(volume.sum())
    corners = np.stack([a, b, c], axis=1)
    centre = np.einsum("i,ij->j", volume, corners.sum(axis=1) / 4) / total if total else np.zeros(3)
    sums = corners.sum(axis=1)
    products = np.einsum("i,ikj,ikl->jl", volume, corners, corners) + np.einsum("i,ij,il->jl", volume, sums, sums)
    spread = products / 20 - total * np.outer(centre, centre)
    return Filling(total, centre + middle, np.trace(spread) * np.eye(3) - spread)


def open_edges(faces: Faces) -> int:
    """How many edges do not lie between exactly two triangles that go round alike."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    size = int(edges.max()) + 1
    forth, back = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
    ways, counts = np.unique(forth, return_counts=True)
    returned, others = np.unique(back, return_counts=True)
    place = np.minimum(np.searchsorted(returned, ways), len(returned) - 1)
    paired = np.where(returned[place] == ways, others[place], 0)
    return int(np.count_nonzero(paired != counts))
