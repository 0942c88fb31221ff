"""A scan as points on its surface, each with its normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.se3 import Array
from ..geometry.stl import read_stl

# Enough that another draw moves no fit by more than 0.1 mm.
_SAMPLES = 6000


@dataclass(frozen=True)
class Scan:
    """Points drawn evenly from a surface, always the same ones.

    Attributes:
        points: (n, 3), m.
        normals: (n, 3), outwards.
        wall: how thick it is if it is a thin shell, m: twice its volume over its area.
    """

    points: Array
    normals: Array
    wall: float

    @classmethod
    def read(cls, stl: bytes, scale: float = 1.0) -> Scan:
        """Of a binary STL in metres; `scale` makes metres of another unit.

        Raises:
            ResourceError: it is no binary STL.
        """
        vertices, faces = read_stl(stl)
        a, b, c = np.moveaxis(vertices[faces] * scale, 1, 0)
        normals = np.cross(b - a, c - a)
        twice = np.linalg.norm(normals, axis=1)
        normals /= np.where(twice > 0, twice, 1)[:, None]
        rng = np.random.default_rng(0)
        drawn = rng.choice(len(faces), _SAMPLES, p=twice / twice.sum())
        root, v = np.sqrt(rng.random((_SAMPLES, 1))), rng.random((_SAMPLES, 1))
        points = (1 - root) * a[drawn] + root * (1 - v) * b[drawn] + root * v * c[drawn]
        volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
        # Some programs write triangles the other way round.
        return cls(points, normals[drawn] * np.sign(volume), 4 * abs(volume) / float(twice.sum()))

    @property
    def foot(self) -> float:
        """Height of its lowest point, m."""
        return float(self.points[:, 2].min())
