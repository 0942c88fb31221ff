"""Start distribution of `put_bottles`: sizes and poses of six bottles and a bin, sampled from a seed.

All constants of this module are from amazon-far/abc e5e1fbc, class `PutBottlesSimConfig` of `abc_minimal/config.py`.
Random numbers are drawn in the same order as in its `PutBottlesEnv.reset`, so a seed gives the same start there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from ..core.errors import SimulationError
from ..core.geometry.se3 import Array

BOTTLE_COUNT = 6
_BOTTLE_SCALE = (0.9, 1.1)  # range of the factor by which a bottle is scaled
_BIN_SCALE = (0.95, 1.05)  # range of the factor by which the bin is scaled

_TABLE_HEIGHT = 0.75  # m, of the table's top over the floor
_TABLE_X, _TABLE_Y = (0.3025, 0.8975), (-0.65, 0.65)  # m, in which whole bottles lie
_BOTTLE_RADII = (0.025667, 0.024014, 0.020589, 0.026359, 0.023689, 0.021823)  # m, of a lying bottle's side
_BOTTLE_LENGTHS = (0.166718, 0.165000, 0.156531, 0.160000, 0.166689, 0.159200)  # m, from the foot to the cap
_BOTTLE_HALF_WIDTHS = (0.025672, 0.024013, 0.020566, 0.025957, 0.023689, 0.021823)  # m, of the outline on the table
_SPAWN_GAP = 0.005  # m, between a bottle and the table
_MARGIN = 0.04  # m, between the circles around outlines
_MAX_TRIES = 200  # samples of a bottle's pose; the last one is kept even if it overlaps another object

_BIN_X, _BIN_Y = (0.57, 0.73), (-0.25, 0.25)  # m, of the bin's origin
_BIN_YAW = (-0.75, 0.75)  # rad
_BIN_HEIGHT = 0.83  # m, of the bin's origin over the floor; times its scale
_BIN_RADIUS = 0.13  # m, of the circle around the bin; times its scale
_BIN_QUAT = (0.70710678, 0.70710678, 0.0, 0.0)  # w, x, y, z: turns the mesh's y axis upwards
_LYING_QUAT = (math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0)  # w, x, y, z: turns a bottle's axis to x


@dataclass(frozen=True)
class BottlesStart:
    """A sampled start.

    Attributes:
        bottle_scales: factors of the bottles' sizes (6,), float32.
        bin_scale: factor of the bin's size.
        bottles: positions in `world`, m, and quaternions w, x, y, z of the bottles (6, 7).
        bin_pose: position in `world`, m, and quaternion of the bin (7,).
    """

    bottle_scales: np.ndarray
    bin_scale: float
    bottles: Array
    bin_pose: Array


def sample_start(seed: int) -> BottlesStart:
    """Sample the start of a seed.

    Raises:
        SimulationError: no pose of a bottle is on the table.
    """
    rng = np.random.default_rng(seed)
    scales = rng.uniform(*_BOTTLE_SCALE, size=BOTTLE_COUNT).astype(np.float32)
    bin_scale = float(rng.uniform(*_BIN_SCALE))
    bin_yaw = float(rng.uniform(*_BIN_YAW))
    bin_xy = [float(rng.uniform(*_BIN_X)), float(rng.uniform(*_BIN_Y))]
    bin_pose = np.array([*bin_xy, _BIN_HEIGHT * bin_scale, *_turned(bin_yaw, _BIN_QUAT)])
    circles = [(np.array(bin_xy), _BIN_RADIUS * bin_scale)]
    bottles = [_sample_bottle(rng, k, float(scales[k]), circles) for k in range(BOTTLE_COUNT)]
    return BottlesStart(scales, bin_scale, np.array(bottles), bin_pose)


def _sample_bottle(
    rng: np.random.Generator, k: int, scale: float, circles: list[tuple[Array, float]]
) -> tuple[float, ...]:
    """Return the pose (7,) of bottle `k`, and append the circle around its outline to `circles`."""
    found = None
    for _ in range(_MAX_TRIES):
        yaw = float(rng.uniform(-math.pi, math.pi))
        low, high = _outline_extent(k, scale, yaw)
        (x_min, x_max), (y_min, y_max) = (
            (table[0] - low[axis], table[1] - high[axis]) for axis, table in enumerate((_TABLE_X, _TABLE_Y))
        )
        if x_min > x_max or y_min > y_max:
            continue
        xy = float(rng.uniform(x_min, x_max)), float(rng.uniform(y_min, y_max))
        centre, radius = np.array(xy) + 0.5 * (low + high), float(0.5 * np.linalg.norm(high - low))
        found = xy, yaw, centre, radius
        if all(np.linalg.norm(centre - other) > radius + size + _MARGIN for other, size in circles):
            break
    if found is None:
        raise SimulationError(f"put_bottles: no pose of bottle {k + 1} lies on the table")
    xy, yaw, centre, radius = found
    circles.append((centre, radius))
    quat = _turned(yaw, _LYING_QUAT)
    height = _TABLE_HEIGHT + _BOTTLE_RADII[k] * scale + _SPAWN_GAP
    return (*xy, height, *(quat / np.linalg.norm(quat)))


def _outline_extent(k: int, scale: float, yaw: float) -> tuple[Array, Array]:
    """Return the smallest and largest (x, y) of a lying bottle's outline relative to its origin, m."""
    length, half = _BOTTLE_LENGTHS[k] * scale, _BOTTLE_HALF_WIDTHS[k] * scale
    corners = np.array([[0.0, -half], [0.0, half], [length, -half], [length, half]])
    c, s = math.cos(yaw), math.sin(yaw)
    turned = corners @ np.array([[c, -s], [s, c]]).T
    return turned.min(axis=0), turned.max(axis=0)


def _turned(yaw: float, quat: tuple[float, ...]) -> Array:
    """Return the quaternion `quat` after a further turn by `yaw`, rad, about the vertical."""
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]), np.array(quat))
    return turned
