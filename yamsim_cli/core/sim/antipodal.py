"""Where two fingers can press on a thing from opposite sides, found by rays on what of it collides."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import mujoco
import numpy as np

from ..geometry.se3 import Array, pose
from .shapes import geom_points

# How many lines are tried through a thing, along each of the directions.
_POINTS = 24

# Of the thing's frame: its axes, and what lies in the middle between two of them and between all three.
_DIRECTIONS = tuple(
    np.array(direction) / math.sqrt(sum(map(abs, direction)))
    for direction in itertools.product((0, 1, -1), repeat=3)
    if next((part for part in direction if part), 0) == 1
)

# Faces that stand more oblique to the line than this are no place to press on, as a tangent. It is measured over so
# much beside the line, m.
_STEEPEST = math.tan(math.radians(15))
_BESIDE = 0.003

# Balls around geoms count as so much larger where a ray is said to pass them by: a factor of the radius squared.
_ROUNDED = 1.001

# From outside of anything on a table, m.
_OUTSIDE = 1.0


@dataclass(frozen=True)
class Span:
    """A line through a thing whose ends two fingers can press on.

    Attributes:
        middle: of the line (3,), in the thing's frame, m.
        direction: of the line (3,), there.
        width: between the ends, m.
        steepness: of the more oblique face, as a tangent: 0 where both are square to the line.
    """

    middle: Array
    direction: Array
    width: float
    steepness: float


def spans(model: mujoco.MjModel, data: mujoco.MjData, body: int, widest: float) -> list[Span]:
    """Lines through a body no longer than `widest` (m), those near its centre of mass and square to faces first."""
    T = pose(data.xpos[body], data.xmat[body].reshape(3, 3))
    geoms = [g for g in range(model.ngeom) if model.body_rootid[model.geom_bodyid[g]] == body and model.geom_contype[g]]
    points, _ = geom_points(model, [g for g in geoms if model.geom_bodyid[g] == body], _POINTS)
    centre = model.body_ipos[body]
    found = []
    for point, direction in itertools.product((centre, *points), _DIRECTIONS):
        span = _span(model, data, geoms, T, point, direction)
        if span is not None and span.width <= widest and span.steepness <= _STEEPEST:
            found.append(span)
    return sorted(found, key=lambda span: float(np.linalg.norm(span.middle - centre)) + 0.05 * span.steepness)


def _span(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], T: Array, point: Array, direction: Array
) -> Span | None:
    side = np.cross(direction, (0.0, 0.0, 1.0) if abs(direction[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    offsets = [np.zeros(3), _BESIDE * side, -_BESIDE * side, _BESIDE * other, -_BESIDE * other]
    reached = []
    for sign in (1.0, -1.0):
        depths = [_first(model, data, geoms, T, point + offset, sign * direction) for offset in offsets]
        if any(depth is None for depth in depths):
            return None
        reached.append(np.array(depths, float))
    slopes = [abs(d[1] - d[2]) / (2 * _BESIDE) for d in reached] + [abs(d[3] - d[4]) / (2 * _BESIDE) for d in reached]
    high, low = float(reached[0][0]), -float(reached[1][0])
    middle: Array = point + direction * (high + low) / 2
    return Span(middle, direction, high - low, max(slopes))


def _first(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], T: Array, point: Array, direction: Array
) -> float | None:
    """How far from a point along a direction a ray from outside meets the thing, m; None if it misses."""
    start, ray = T[:3, :3] @ (point + _OUTSIDE * direction) + T[:3, 3], T[:3, :3] @ -direction
    nearest = math.inf
    # A vessel's wall is dozens of boxes, and a ray passes most of them by.
    to = data.geom_xpos[geoms] - start
    off = to - np.outer(to @ ray, ray)
    for geom in np.asarray(geoms)[np.einsum("gi,gi->g", off, off) <= model.geom_rbound[geoms] ** 2 * _ROUNDED]:
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            distance = mujoco.mj_rayMesh(model, data, geom, start, ray)
        else:
            distance = mujoco.mju_rayGeom(
                data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom], start, ray, model.geom_type[geom]
            )
        distance = distance[0] if isinstance(distance, tuple) else distance
        if distance >= 0:
            nearest = min(nearest, float(distance))
    return _OUTSIDE - nearest if nearest < 2 * _OUTSIDE else None
