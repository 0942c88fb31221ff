"""Mass and inertia of primitives filled evenly, and where two fingers fit around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..config.primitives import Primitive
from ..geometry.se3 import Array, quat_from_rotation
from .distance import signed_distance

# Points along the longest side of the box in which mass is counted, and least distance between them, m.
_CELLS = 90
_LEAST_STEP = 5e-4


@dataclass(frozen=True)
class Body:
    """Evenly spaced points (n, 3) inside of primitives, m, and how far apart they are along each axis."""

    points: Array
    step: float

    @classmethod
    def fill(cls, parts: Sequence[Primitive], low: Array, high: Array) -> Body:
        """Of primitives that lie within a box (3,), (3,), m."""
        step = max(float((high - low).max()) / _CELLS, _LEAST_STEP)
        counts = np.ceil((high - low) / step).astype(int)
        # In the middle of the box, so that what is symmetric stays so.
        axes = [m + step * (np.arange(n) - (n - 1) / 2) for m, n in zip((low + high) / 2, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls(points[signed_distance(parts, points) <= 0], step)

    @property
    def centre(self) -> Array:
        """Centre of mass (3,), m."""
        centre: Array = self.points.mean(axis=0)
        return centre

    def inertia(self, mass: float) -> tuple[Array, Array]:
        """Principal moments (3,), kg m2, about the centre of mass, and the quaternion of the frame they hold in."""
        rest = self.points - self.centre
        spread = mass * (rest.T @ rest) / len(rest)
        moments, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        return moments, quat_from_rotation(axes)

    def width(self, height: float, axis_deg: float, at: tuple[float, float], half: float) -> tuple[float, float] | None:
        """How wide it is (m) along a horizontal axis where pads close on it, and its middle along that axis.

        Args:
            height: of the pads' middle, m.
            at: a place (x, y) that the pads' closing axis goes through, m.
            half: half the pads' width and height, m.

        Returns:
            None where there is nothing between the pads.
        """
        angle = math.radians(axis_deg)
        along = (self.points[:, :2] - at) @ [math.cos(angle), math.sin(angle)]
        across = (self.points[:, :2] - at) @ [-math.sin(angle), math.cos(angle)]
        between = along[(np.abs(across) <= half) & (np.abs(self.points[:, 2] - height) <= half)]
        if not len(between):
            return None
        return float(np.ptp(between)) + self.step, float(between.max() + between.min()) / 2
