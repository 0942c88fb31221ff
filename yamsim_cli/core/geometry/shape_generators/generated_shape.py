from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..loft import Surface
from ..se3 import Array

# A collision primitive in the format of object configs.
PrimitiveData = Mapping[str, Any]

_MIN_WALL = 0.002  # m, of a collision wall; objects can pass through thinner walls


@dataclass(frozen=True)
class ShapePiece:
    """A closed surface of one material; `role`, such as "body" or "handle", selects the material."""

    role: str
    surface: Surface


@dataclass(frozen=True)
class ShapeGrasp:
    """A grasp from above with two fingers.

    Attributes:
        grasped_part: "body", "rim", "edge" or "handle".
        position: midpoint (3,) between the pads, m.
        axis_deg: closing direction of the fingers from +x.
        width: of the object between the pads, m.
        has_flat_contact: whether both pads touch with their faces. On a line contact, the object pivots.
        tilt_deg: of the hand from vertical towards `axis_deg`, with which the pads are parallel to the grasped wall.
            None for grasps that do not need it.
        depth: of the object between the fingers, along them, m. A longer lever resists rotation better.
    """

    grasped_part: str
    position: tuple[float, float, float]
    axis_deg: float
    width: float
    has_flat_contact: bool = True
    tilt_deg: float | None = None
    depth: float = 0.016


@dataclass(frozen=True)
class GeneratedShape:
    """An upright object, z up, with the origin on the ground below its middle.

    Attributes:
        grasps: the best first; empty if no grasp from above is possible.
        preposition: "in" or "on", for placing other objects in or on this one.
        support_height: of the surface in the middle for placing objects, m; None if no object would stay there.
        rolling_radius: least radius of the round surface on which the object can roll, m; 0 for a flat foot.
        is_axisymmetric: whether all grasps of one `grasped_part` are equal.
    """

    pieces: tuple[ShapePiece, ...]
    collision: tuple[PrimitiveData, ...]
    grasps: tuple[ShapeGrasp, ...]
    preposition: str = "on"
    support_height: float | None = None
    rolling_radius: float = 0.0
    is_axisymmetric: bool = False


def box_data(centre: Sequence[float], size: Sequence[float], yaw_deg: float = 0.0) -> PrimitiveData:
    """Return a box with a centre (3,) and full size (3,), m, turned about z."""
    plain = {"type": "box", "centre": _rounded_list(centre), "half_size": _rounded_list(np.divide(size, 2))}
    return plain | ({"yaw_deg": yaw_deg} if yaw_deg else {})


def cylinder_data(low: float, high: float, radius: float) -> PrimitiveData:
    """Return an upright cylinder about the z axis between two heights, m."""
    return {
        "type": "cylinder",
        "centre": [0.0, 0.0, _round_value((low + high) / 2)],
        "radius": _round_value(radius),
        "half_height": _round_value((high - low) / 2),
    }


def sphere_data(centre: Sequence[float], radius: float) -> PrimitiveData:
    """Return a sphere with a centre (3,) and radius, m."""
    return {"type": "sphere", "centre": _rounded_list(centre), "radius": _round_value(radius)}


def capsule_data(start: ArrayLike, end: ArrayLike, radius: float) -> PrimitiveData:
    """Return a capsule with the ends (3,) of its axis and its radius, m."""
    return {"type": "capsule", "start": _rounded_list(start), "end": _rounded_list(end), "radius": _round_value(radius)}


def capsules_along(path: ArrayLike, radius: float, *, closed: bool = False) -> list[PrimitiveData]:
    """Return capsules along a path (n, 3), m, and back to its start if `closed`."""
    points = list(np.asarray(path, float))
    return [capsule_data(a, b, radius) for a, b in itertools.pairwise([*points, points[0]] if closed else points)]


def ring_boxes(corners: Array, wall: float, segments: int) -> list[PrimitiveData]:
    """Return a ring of boxes for each piece of an inner surface's profile (n, 2: radius, height), m."""
    return [
        {
            "type": "ring",
            "inner": _rounded_list(a),
            "outer": _rounded_list(b),
            "thickness": _round_value(max(wall, _MIN_WALL)),
            "segments": segments,
        }
        for a, b in itertools.pairwise(corners)
    ]


def simplify_polyline(profile: Array, tolerance: float) -> Array:
    """Simplify a polyline (m, n) to some of its points (k, n) by the Ramer-Douglas-Peucker algorithm.

    `tolerance` is the largest distance of an omitted point from the result, in the unit of the polyline.
    """
    start, end = profile[0], profile[-1]
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-12)
    rest = profile - start
    off = np.linalg.norm(rest - np.outer(rest @ along, along), axis=1)
    worst = int(off.argmax())
    if off[worst] <= tolerance or worst in (0, len(profile) - 1):
        return np.array([start, end])
    return np.concatenate(
        [simplify_polyline(profile[: worst + 1], tolerance)[:-1], simplify_polyline(profile[worst:], tolerance)]
    )


def _rounded_list(values: ArrayLike) -> list[float]:
    return [_round_value(float(value)) for value in np.asarray(values, float)]


def _round_value(value: float) -> float:
    return round(float(value), 5) + 0.0  # -0.0 becomes 0.0
