from __future__ import annotations

import numpy as np

from ..loft import Surface, loft, loft_closed
from ..se3 import Array
from .generated_shape import GeneratedShape, ShapeGrasp, ShapePiece, capsule_data

_SEGMENTS = 48  # visual faces around the axis


def make_pasta(diameter: float, length: float, wall: float, slant_deg: float, ridges: int) -> GeneratedShape:
    """Return a piece of dry pasta along y.

    Args:
        diameter, length: outer dimensions, m.
        wall: of a tube, m; 0 for a rod.
        slant_deg: angle of the ends from a straight cut.
        ridges: number of lengthwise ridges.
    """
    radius = diameter / 2
    surface = _pipe_surface(radius, length, wall, np.tan(np.radians(slant_deg)), ridges)
    half = max(length / 2 - radius * (1 if wall == 0 else 0.9), 0.0005)
    hull = capsule_data((0, -half, radius), (0, half, radius), radius)
    grasp = ShapeGrasp("body", (0.0, 0.0, round(radius, 4)), 0.0, diameter)
    return GeneratedShape((ShapePiece("body", surface),), (hull,), (grasp,), rolling_radius=radius)


def _pipe_surface(radius: float, length: float, wall: float, slant: float, ridges: int) -> Surface:
    angle = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    outer = radius * (1 - (0.03 + 0.03 * np.cos(ridges * angle) if ridges else 0.0 * angle))
    straight = length / 2 - slant * radius

    def outline_at_end(r: Array, end: float, inset: float) -> Array:
        x, z = r * np.cos(angle), r * np.sin(angle)
        return np.column_stack([x, end * (straight - inset) + slant * z, z + radius])

    bevel = min(0.0006, radius / 6)
    loops = [
        outline_at_end(outer - bevel, -1, 0),
        outline_at_end(outer, -1, bevel),
        outline_at_end(outer, 1, bevel),
        outline_at_end(outer - bevel, 1, 0),
    ]
    if not wall:
        return loft(loops[::-1])
    inner = np.full(_SEGMENTS, radius - wall)
    loops += [outline_at_end(inner, 1, 0), outline_at_end(inner, -1, 0)]
    return loft_closed(loops[::-1])
