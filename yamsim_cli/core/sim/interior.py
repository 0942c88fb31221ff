from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..geometry.height_map import compute_height_map
from ..geometry.loft import Surface
from ..geometry.se3 import Array, rotation_from_vector, rotation_z

_RAYS_PER_SIDE = (
    64  # rays along the longer side of a body seen from one direction: 2 mm apart for a mug, 4 mm for a bin
)
_HORIZONTAL_VIEWS = 8  # with four, the space beside a slanted handle counts as enclosed

_Z_TO_X_ROTATION = rotation_from_vector([0.0, -math.pi / 2, 0.0])

# Rotations (views, 3, 3) from a body's frame to frames with z along the rays: down, up, and horizontal directions.
_RAY_FRAME_ROTATIONS = np.array(
    [
        rotation_from_vector([math.pi, 0.0, 0.0]),
        np.eye(3),
        *(_Z_TO_X_ROTATION @ rotation_z(2 * math.pi * k / _HORIZONTAL_VIEWS) for k in range(_HORIZONTAL_VIEWS)),
    ]
)


class Interior:
    """The space that one rigid body encloses, in the body's frame.

    A point lies inside if rays from the point hit the body in enough directions:
    - down and in all eight horizontal directions, as in a cup, a bin or a drawer; or
    - down, up, and in at least one of each two opposite horizontal directions, as in a cupboard with an open front.

    The space under or in the loop of a mug's handle is therefore not inside. The body's solid parts count as inside,
    because no other object can be there. Rays pass through gaps in walls, such as the gaps between wires.
    """

    def __init__(self, surface: Surface) -> None:
        self._low, self._high = surface[0].min(axis=0), surface[0].max(axis=0)
        grids = [compute_height_map((surface[0] @ R.T, surface[1]), _RAYS_PER_SIDE) for R in _RAY_FRAME_ROTATIONS]
        self._first = np.array([(grid.x[0], grid.y[0]) for grid in grids])
        self._cell = np.array([grid.cell_size for grid in grids])
        # Coordinate, m, of the last hit along each ray of each direction; -inf for no hit, as for rays at the edges.
        self._reach = np.full((len(grids), *np.max([grid.top.shape for grid in grids], axis=0)), -np.inf)
        for reach, grid in zip(self._reach, grids, strict=True):
            reach[: len(grid.x), : len(grid.y)] = grid.top

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return whether each point (n, 3) lies inside, as (n,)."""
        held: NDArray[np.bool_] = ((points >= self._low) & (points <= self._high)).all(axis=1)
        if held.any():
            down, up, *around = self._rays_hit_beyond(points[held])
            half = len(around) // 2
            either = [one | opposite for one, opposite in zip(around[:half], around[half:], strict=True)]
            held[held] = down & (np.all(around, axis=0) | (up & np.all(either, axis=0)))
        return held

    def _rays_hit_beyond(self, points: Array) -> NDArray[np.bool_]:
        """Return whether the nearest ray of each direction hits beyond each point (n, 3), as (directions, n)."""
        x, y, z = (points @ _RAY_FRAME_ROTATIONS[:, axis].T for axis in range(3))
        _, nx, ny = self._reach.shape
        i = np.clip(np.rint((x - self._first[:, 0]) / self._cell), 0, nx - 1)
        j = np.clip(np.rint((y - self._first[:, 1]) / self._cell), 0, ny - 1)
        ray = ((np.arange(len(_RAY_FRAME_ROTATIONS)) * nx + i) * ny + j).astype(np.intp)
        met: NDArray[np.bool_] = (self._reach.ravel()[ray] > z).T
        return met
