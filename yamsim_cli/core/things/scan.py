"""A scan as points on its surface, each with its normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.se3 import Array
from ..geometry.stl import Faces, read_stl

# Points that are sampled. With so many, other samples change no fit by more than 0.1 mm.
_SAMPLES = 6000


@dataclass(frozen=True)
class Scan:
    """Points sampled evenly from a surface; the same surface gives the same points.

    Attributes:
        points: the points (n, 3), m.
        normals: the outward normals (n, 3) there.
        wall: the thickness of the wall if the scan is a thin shell, m: twice its volume over its area.
    """

    points: Array
    normals: Array
    wall: float

    @classmethod
    def read(cls, stl: bytes, scale: float = 1.0) -> Scan:
        """The scan in a binary STL.

        Args:
            scale: metres in one unit of the file.

        Raises:
            ResourceError: it is no binary STL.
        """
        vertices, faces = read_stl(stl)
        return cls.of(vertices * scale, faces)

    @classmethod
    def of(cls, vertices: Array, faces: Faces) -> Scan:
        """Of triangles (m, 3) over vertices (n, 3), m."""
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        normals = np.cross(b - a, c - a)
        twice = np.linalg.norm(normals, axis=1)
        normals /= np.where(twice > 0, twice, 1)[:, None]
        rng = np.random.default_rng(0)
        chosen = rng.choice(len(faces), _SAMPLES, p=twice / twice.sum())
        root, v = np.sqrt(rng.random((_SAMPLES, 1))), rng.random((_SAMPLES, 1))
        points = (1 - root) * a[chosen] + root * (1 - v) * b[chosen] + root * v * c[chosen]
        volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
        # Some programs write triangles in the opposite order.
        return cls(points, normals[chosen] * np.sign(volume), 4 * abs(volume) / float(twice.sum()))

    @property
    def foot(self) -> float:
        """Height of its lowest point, m."""
        return float(self.points[:, 2].min())
