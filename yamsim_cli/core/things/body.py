"""Mass distribution and width of primitives that are filled evenly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..config.things.primitives import Primitive
from ..geometry.closed import columns
from ..geometry.se3 import Array, quat_from_rotation
from ..geometry.stl import Faces
from .distance import signed_distance

# Points along the longest side of the box that is searched for mass, and their smallest distance, m.
_CELLS = 90
_LEAST_STEP = 5e-4


@dataclass(frozen=True)
class Body:
    """Evenly spaced points (n, 3) inside primitives, and their distance along each axis, m."""

    points: Array
    step: float

    @classmethod
    def fill(cls, parts: Sequence[Primitive], low: Array, high: Array) -> Body:
        """The points inside primitives that lie within a box with corners `low` and `high` (3,), m."""
        step = max(float((high - low).max()) / _CELLS, _LEAST_STEP)
        counts = np.ceil((high - low) / step).astype(int)
        # The grid is centred in the box, so that symmetric primitives give symmetric points.
        axes = [m + step * (np.arange(n) - (n - 1) / 2) for m, n in zip((low + high) / 2, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls(points[signed_distance(parts, points) <= 0], step)

    @classmethod
    def inside(cls, vertices: Array, faces: Faces) -> Body:
        """Of what a closed surface encloses; empty for one that encloses nothing.

        Args:
            vertices, faces: (n, 3) in m, and (m, 3).
        """
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        step = max(float((high - low).max()) / _CELLS, _LEAST_STEP)
        # Off the middle by an odd share: a line through an edge goes through two triangles there.
        axes = [(a + b) / 2 + step * (np.arange(-60, 61) + 0.0137) for a, b in zip(low, high, strict=True)]
        x, y = (
            np.array([v for v in axis if a <= v <= b]) for axis, a, b in zip(axes[:2], low[:2], high[:2], strict=True)
        )
        heights = np.array([v for v in axes[2] if low[2] <= v <= high[2]])
        xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        found = [np.zeros((0, 3))]
        for place, crossings in zip(xy, columns(vertices, faces, xy), strict=True):
            within = np.searchsorted(crossings, heights) % 2 == 1
            if len(crossings) % 2 == 0 and within.any():
                found.append(np.column_stack([np.tile(place, (int(within.sum()), 1)), heights[within]]))
        return cls(np.concatenate(found), step)

    @property
    def centre(self) -> Array:
        """Centre of mass (3,), m."""
        centre: Array = self.points.mean(axis=0)
        return centre

    def inertia(self, mass: float) -> tuple[Array, Array]:
        """Principal moments (3,), kg m2, about the centre of mass, and the quaternion of their axes."""
        rest = self.points - self.centre
        spread = mass * (rest.T @ rest) / len(rest)
        moments, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        return moments, quat_from_rotation(axes)

    def width(self, height: float, axis_deg: float, at: tuple[float, float], half: float) -> tuple[float, float] | None:
        """The width (m) of what two pads close on along a horizontal axis, and its middle along that axis.

        Args:
            height: height of the pads' middle, m.
            axis_deg: heading of the axis, degrees.
            at: a point (x, y) on the axis, m.
            half: half the pads' width and height, m.

        Returns:
            None if there is nothing between the pads.
        """
        angle = math.radians(axis_deg)
        along = (self.points[:, :2] - at) @ [math.cos(angle), math.sin(angle)]
        across = (self.points[:, :2] - at) @ [-math.sin(angle), math.cos(angle)]
        between = along[(np.abs(across) <= half) & (np.abs(self.points[:, 2] - height) <= half)]
        if not len(between):
            return None
        return float(np.ptp(between)) + self.step, float(between.max() + between.min()) / 2
