"""Distances from collision primitives; mass properties of bodies, and widths between two fingers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.config.objects.primitives import Box, Capsule, Cylinder, Primitive, Ring, Sphere
from ..core.geometry.height_map import crossings_along_z
from ..core.geometry.se3 import Array, quat_from_rotation
from ..core.geometry.stl import Faces

_GRID_POINTS_PER_SIDE = 90  # grid points along the longest side of a filled box
_MIN_STEP = 5e-4  # m, between grid points


def signed_distance(parts: Sequence[Primitive], points: Array) -> Array:
    """Return signed distances (n,) of points (n, 3) from a union of primitives, m; negative inside.

    In overlaps, the depth is the deepest of any primitive.
    """
    nearest: Array = np.min([_distance_from_primitive(part, points) for part in parts], axis=0)
    return nearest


def _distance_from_primitive(part: Primitive, points: Array) -> Array:
    match part:
        case Sphere():
            distance: Array = np.linalg.norm(points - part.centre, axis=1) - part.radius
        case Capsule():
            start, along = np.array(part.start), np.subtract(part.end, part.start)
            share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0, 1)
            distance = np.linalg.norm(points - start - share[:, None] * along, axis=1) - part.radius
        case Cylinder():
            x, y, z = (points - part.centre).T
            distance = _box_distance(np.hypot(x, y) - part.radius, np.abs(z) - part.half_height)
        case Box():
            distance = _box_distance(*(np.abs(_to_box_frame(part, points)) - part.half_size).T)
        case Ring():
            # A ring's section is a rectangle below the line from inner to outer edge.
            along = np.subtract(part.outer, part.inner)
            length = float(np.linalg.norm(along))
            rest = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]]) - part.inner
            u, v = rest @ along / length, rest @ np.array([-along[1], along[0]]) / length
            distance = _box_distance(
                np.abs(u - length / 2) - length / 2, np.abs(v + part.thickness / 2) - part.thickness / 2
            )
    return distance


def _to_box_frame(part: Box, points: Array) -> Array:
    c, s = math.cos(math.radians(part.yaw_deg)), math.sin(math.radians(part.yaw_deg))
    x, y, z = (points - part.centre).T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def _box_distance(*along: Array) -> Array:
    """Return the signed distance, given distances past the faces along each axis."""
    past = np.array(along)
    distance: Array = np.linalg.norm(np.maximum(past, 0), axis=0) + np.minimum(past.max(axis=0), 0)
    return distance


@dataclass(frozen=True)
class PointBody:
    """A solid body as grid points (n, 3) inside it, `step` apart, m."""

    points: Array
    step: float

    @classmethod
    def from_primitives(cls, parts: Sequence[Primitive], low: Array, high: Array) -> PointBody:
        """Fill primitives within the box from `low` to `high` (3,), m."""
        step = max(float((high - low).max()) / _GRID_POINTS_PER_SIDE, _MIN_STEP)
        counts = np.ceil((high - low) / step).astype(int)
        # A centred grid gives symmetric points for symmetric primitives.
        axes = [m + step * (np.arange(n) - (n - 1) / 2) for m, n in zip((low + high) / 2, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls(points[signed_distance(parts, points) <= 0], step)

    @classmethod
    def from_mesh(cls, vertices: Array, faces: Faces) -> PointBody:
        """Fill a closed surface of triangles (m, 3) over vertices (n, 3), m."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        step = max(float((high - low).max()) / _GRID_POINTS_PER_SIDE, _MIN_STEP)
        # Vertical lines through an edge would cross two triangles; the irregular shift avoids them.
        axes = [(a + b) / 2 + step * (np.arange(-60, 61) + 0.0137) for a, b in zip(low, high, strict=True)]
        x, y = (
            np.array([v for v in axis if a <= v <= b]) for axis, a, b in zip(axes[:2], low[:2], high[:2], strict=True)
        )
        heights = np.array([v for v in axes[2] if low[2] <= v <= high[2]])
        xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        found = [np.zeros((0, 3))]
        for place, crossings in zip(xy, crossings_along_z(vertices, faces, xy), strict=True):
            within = np.searchsorted(crossings, heights) % 2 == 1
            if len(crossings) % 2 == 0 and within.any():
                found.append(np.column_stack([np.tile(place, (int(within.sum()), 1)), heights[within]]))
        return cls(np.concatenate(found), step)

    @property
    def centre(self) -> Array:
        """Centre of mass (3,), m."""
        centre: Array = self.points.mean(axis=0)
        return centre

    def principal_inertia(self, mass: float) -> tuple[Array, Array]:
        """Return principal moments (3,), kg m2, and their axes' quaternion (wxyz)."""
        rest = self.points - self.centre
        spread = mass * (rest.T @ rest) / len(rest)
        moments, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        return moments, quat_from_rotation(axes)

    def width_between_pads(
        self, height: float, axis_deg: float, at: tuple[float, float], half: float
    ) -> tuple[float, float] | None:
        """Return the width between two finger pads, and its middle along their axis, m; None if nothing is there.

        Args:
            height: of the pads' middle, m.
            axis_deg: heading of the pads' horizontal axis, degrees.
            at: point (x, y) from which the middle is measured, m.
            half: half the pads' width and height, m.
        """
        angle = math.radians(axis_deg)
        along = (self.points[:, :2] - at) @ [math.cos(angle), math.sin(angle)]
        across = (self.points[:, :2] - at) @ [-math.sin(angle), math.cos(angle)]
        between = along[(np.abs(across) <= half) & (np.abs(self.points[:, 2] - height) <= half)]
        if not len(between):
            return None
        return float(np.ptp(between)) + self.step, float(between.max() + between.min()) / 2


def primitive_data(part: Primitive) -> dict[str, Any]:
    """Return config data, rounded to 0.01 mm."""
    data: dict[str, Any] = part.model_dump(exclude_none=True)
    return {key: _round_lengths(value) for key, value in data.items()}


def _round_lengths(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [round(float(x), 5) for x in value]
    return round(value, 5) if isinstance(value, float) else value
