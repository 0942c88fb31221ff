"""Search for antipodal pairs, on which two fingers can press an object from opposite sides, by ray casting."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import mujoco
import numpy as np

from ..geometry.se3 import Array, pose
from .geom_shapes import geom_points

_RAY_POINTS = 24  # points inside an object through which lines are tried, besides the centre of mass

# The object's axes, and the bisectors of two and of three axes.
_DIRECTIONS = tuple(
    np.array(direction) / math.sqrt(sum(map(abs, direction)))
    for direction in itertools.product((0, 1, -1), repeat=3)
    if next((part for part in direction if part), 0) == 1
)

_MAX_SLOPE = math.tan(math.radians(15))  # tangent, of a face against the plane normal to the line
_SLOPE_RAY_OFFSET = 0.003  # m, from the line of the rays that measure slopes
_SQUARED_RADIUS_FACTOR = 1.001  # of geoms' bounding spheres, against rounding errors
_RAY_START = 1.0  # m, from a point in an object; larger than any object on a table


@dataclass(frozen=True)
class AntipodalPair:
    """A line through an object, with a finger contact at each end.

    Attributes:
        middle: (3,), in the object's frame, m.
        direction: unit vector (3,) along the line in the object's frame.
        width: distance between the ends, m.
        steepness: slope of the steeper face, as a tangent; 0 if both faces are perpendicular to the line.
    """

    middle: Array
    direction: Array
    width: float
    steepness: float


def find_antipodal_pairs(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, max_width: float
) -> list[AntipodalPair]:
    """Return the antipodal pairs of a body at most `max_width` m apart, those near the centre of mass first.

    Among equally near pairs, those on faces perpendicular to the line come first.
    """
    T = pose(data.xpos[body], data.xmat[body].reshape(3, 3))
    geoms = [g for g in range(model.ngeom) if model.body_rootid[model.geom_bodyid[g]] == body and model.geom_contype[g]]
    points, _ = geom_points(model, [g for g in geoms if model.geom_bodyid[g] == body], _RAY_POINTS)
    centre = model.body_ipos[body]
    found = []
    for point, direction in itertools.product((centre, *points), _DIRECTIONS):
        pair = _measure_pair(model, data, geoms, T, point, direction)
        if pair is not None and pair.width <= max_width and pair.steepness <= _MAX_SLOPE:
            found.append(pair)
    return sorted(found, key=lambda pair: float(np.linalg.norm(pair.middle - centre)) + 0.05 * pair.steepness)


def _measure_pair(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], T: Array, point: Array, direction: Array
) -> AntipodalPair | None:
    side = np.cross(direction, (0.0, 0.0, 1.0) if abs(direction[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    offsets = [
        np.zeros(3),
        _SLOPE_RAY_OFFSET * side,
        -_SLOPE_RAY_OFFSET * side,
        _SLOPE_RAY_OFFSET * other,
        -_SLOPE_RAY_OFFSET * other,
    ]
    distances = []
    for sign in (1.0, -1.0):
        depths = [_surface_distance(model, data, geoms, T, point + offset, sign * direction) for offset in offsets]
        if any(depth is None for depth in depths):
            return None
        distances.append(np.array(depths, float))
    slopes = [abs(d[1] - d[2]) / (2 * _SLOPE_RAY_OFFSET) for d in distances] + [
        abs(d[3] - d[4]) / (2 * _SLOPE_RAY_OFFSET) for d in distances
    ]
    high, low = float(distances[0][0]), -float(distances[1][0])
    middle: Array = point + direction * (high + low) / 2
    return AntipodalPair(middle, direction, high - low, max(slopes))


def _surface_distance(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], T: Array, point: Array, direction: Array
) -> float | None:
    """Return the distance from a point to the surface along a direction, m, by a ray from outside; None for a miss."""
    start, ray = T[:3, :3] @ (point + _RAY_START * direction) + T[:3, 3], T[:3, :3] @ -direction
    nearest = math.inf
    # Skip the geoms whose bounding sphere the ray misses. The wall of a vessel consists of dozens of boxes.
    to = data.geom_xpos[geoms] - start
    off = to - np.outer(to @ ray, ray)
    for geom in np.asarray(geoms)[
        np.einsum("gi,gi->g", off, off) <= model.geom_rbound[geoms] ** 2 * _SQUARED_RADIUS_FACTOR
    ]:
        if mujoco.mjtGeom(model.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_MESH:
            distance = mujoco.mj_rayMesh(model, data, geom, start, ray)
        else:
            distance = mujoco.mju_rayGeom(
                data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom], start, ray, model.geom_type[geom]
            )
        distance = distance[0] if isinstance(distance, tuple) else distance
        if distance >= 0:
            nearest = min(nearest, float(distance))
    return _RAY_START - nearest if nearest < 2 * _RAY_START else None
