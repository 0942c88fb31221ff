"""Shape of a heap of loose pieces, for `pasta_heap`: the slope of its surface, and how many pieces are in a volume."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from yamsim_cli.core.geometry.se3 import Array

BENCH_GROUP = 5  # of geoms that are no pieces
HALF_WALL, _RING_SIDES = 0.004, 32  # m, half the thickness of a round wall; the number of its sides
_START_SHARE = 0.12  # share of the space that pieces fill before they fall: with 0.2, they hardly find a place
_TRIES = 20_000  # random poses of a piece, of which the first free one is taken
_FOOT = 0.1  # share of its height at which a heap ends
_RING = 0.004  # m, between the circles on which a heap's height is measured, and between the points of a circle
_SAMPLES = 16_000  # points of which those in a capsule sample its volume


def capsule_volume(length: float, radius: float) -> float:
    """Return the volume (m3) of a capsule whose axis, without the round ends, has a length (m)."""
    return math.pi * radius**2 * (length + 4 / 3 * radius)


def slope_of(radii: Array, heights: Array) -> float:
    """Return the slope (degrees) of a heap from its mean height (n,) at increasing distances (n,) from its middle.

    It is the slope of a line through the heights from the middle to the foot, each weighted by its circle's length.
    Not a number if there is no heap.
    """
    if not heights.any():
        return math.nan
    # The middle may be in a gap between pieces.
    outwards = np.append(heights, 0.0)[(peak := int(heights.argmax())) :]
    foot = peak + int(np.argmax(outwards < _FOOT * heights.max()))
    slope = np.polyfit(radii[:foot], heights[:foot], 1, w=np.sqrt(radii[:foot]))[0]
    return math.degrees(math.atan(-slope))


def pieces_below(level: float, ends: Array, radius: float) -> float:
    """Return how many capsules, with axes between `ends` (n, 2, 3), are below a height, m; parts count too."""
    along = ends[:, 1] - ends[:, 0]
    length = float(np.linalg.norm(along[0]))
    points = np.random.default_rng(0).uniform(-1, 1, (_SAMPLES, 3)) * (radius, radius, length / 2 + radius)
    beyond = np.maximum(np.abs(points[:, 2]) - length / 2, 0.0)
    points = points[np.hypot(np.hypot(points[:, 0], points[:, 1]), beyond) < radius]
    upright = along[:, 2] / length
    above = np.outer(upright, points[:, 2]) + np.outer(np.sqrt(np.maximum(1 - upright**2, 0.0)), points[:, 0])
    return float((ends[:, :, 2].mean(axis=1)[:, None] + above < level).mean(axis=1).sum())


def surface_heights(model: mujoco.MjModel, data: mujoco.MjData, places: Array) -> Array:
    """Return the height (n,) of the highest piece at horizontal places (n, 2), m; 0 where there is none."""
    groups = np.array([group != BENCH_GROUP for group in range(6)], np.uint8)
    down, found = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    rays = [mujoco.mj_ray(model, data, np.array([*place, 1.0]), down, groups, 1, -1, found) for place in places]
    return np.array([max(1.0 - ray, 0.0) if ray >= 0 else 0.0 for ray in rays])


def heap_profile(
    model: mujoco.MjModel, data: mujoco.MjData, middle: Array, radius: float, rim: float = 0.0
) -> tuple[Array, Array]:
    """Return distances (n,) from the middle of a heap, up to a radius, and its mean height (n,) over the rim, m."""
    radii = np.arange(0.0, radius, _RING)
    heights = [surface_heights(model, data, middle + _circle(r)).mean() - rim for r in radii]
    return radii, np.maximum(heights, 0.0)


def disc_points(radius: float) -> Array:
    """Return points (n, 2) that cover a disc."""
    return np.vstack([_circle(r) for r in np.arange(0, radius, _RING)])


def _circle(radius: float) -> Array:
    angles = np.linspace(0, 2 * np.pi, max(1, round(2 * np.pi * radius / _RING)), endpoint=False)
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def random_ends(count: int, length: float, radius: float, inside: float, rng: np.random.Generator) -> Array:
    """Return axes (n, 2, 3) of capsules in random directions without contacts, over the floor of a cylinder.

    Args:
        length, radius: of an axis, without the round ends, and of a capsule, m.
        inside: inner radius of the cylinder, m.
    """
    tall = count * capsule_volume(length, radius) / (math.pi * inside**2 * _START_SHARE)
    above = np.array([0.0, 0.0, length / 2 + 2 * radius])
    steps, placed = np.linspace(0, 1, 9)[:, None], np.full((1, 3), np.inf)
    found = []
    for k in range(count):
        for _ in range(_TRIES):
            direction = rng.normal(size=3)
            half = direction / np.linalg.norm(direction) * length / 2
            middle = rng.uniform((-inside, -inside, 0), (inside, inside, tall)) + above
            points = middle - half + 2 * half * steps
            apart = np.linalg.norm(points[:, None] - placed, axis=2).min()
            if np.hypot(points[:, 0], points[:, 1]).max() < inside - 1.1 * radius and apart > 2.3 * radius:
                break
        else:
            raise RuntimeError(f"no place for piece {k + 1} of {count}; lower `_START_SHARE`")
        placed = np.vstack([placed, points])
        found.append(points[[0, -1]])
    return np.array(found)


def add_ring(body: Any, radius: float, height: float, contact: dict[str, Any]) -> None:
    """Add a round wall, from the height 0 upwards, to a body of an `MjSpec`."""
    for angle in np.arange(_RING_SIDES) * 2 * math.pi / _RING_SIDES:
        middle = [(radius + HALF_WALL) * math.cos(angle), (radius + HALF_WALL) * math.sin(angle), height / 2]
        size = [HALF_WALL, 1.1 * (radius + HALF_WALL) * math.pi / _RING_SIDES, height / 2]
        turn = [math.cos(angle / 2), 0, 0, math.sin(angle / 2)]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=middle, quat=turn, group=BENCH_GROUP, **contact)
