"""A simplified mesh of the printed mount that carries a board beside an arm's base.

The mount is a plate with the board in its middle, and a tongue: a low bridge to the base's foot, a step up, and a strip
over the foot. No part beyond the step is higher than the board, so the mount hides no marker.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigError
from .se3 import Array
from .stl import Faces

# mm, x of the end and z of the top of the arm base's foot in its mesh. Source: MuJoCo Menagerie i2rt_yam, model2.stl.
_FOOT_END, _FOOT_TOP = 100.0, 0.6
_STEP_DEPTH = 5.0  # mm, of the step in front of the foot
_PAPER_THICKNESS = 0.1  # mm, thickness of the board


def mount_mesh(
    x_mm: tuple[float, float],
    y_mm: tuple[float, float],
    z_mm: tuple[float, float],
    board_centre_mm: Sequence[float],
    board_size_mm: tuple[float, float],
    mirror_x: bool = False,
) -> tuple[Array, Faces]:
    """Return a mount's vertices (n, 3), m, and triangles (m, 3), in the frame of the mesh of the arm's base.

    Args:
        x_mm, y_mm, z_mm: lower and upper end of the mount, before mirroring.
        board_centre_mm: after mirroring.
        mirror_x: whether the mount is mirrored at x = 0.
    """
    (x0, x1), (y0, y1), (z0, z1) = x_mm, y_mm, z_mm
    board_x = -board_centre_mm[0] if mirror_x else board_centre_mm[0]
    board_y, board_z = board_centre_mm[1:]
    half_width, half_height = board_size_mm[0] / 2, board_size_mm[1] / 2
    plate_x0, plate_top = max(x0, 2 * board_x - x1), board_z - _PAPER_THICKNESS
    on_mount = (
        plate_x0 <= board_x - half_width
        and board_x + half_width <= x1
        and y0 <= board_y - half_height
        and board_y + half_height <= y1
        and z0 < plate_top <= z1
    )
    if not on_mount:
        mirrored = ", mirrored" if mirror_x else ""
        raise ConfigError(
            f"a board of {board_size_mm[0]:.1f} x {board_size_mm[1]:.1f} mm at x {board_centre_mm[0]:g}, "
            f"y {board_y:g}, z {board_z:g} mm does not lie on its mount (x {x0:g}..{x1:g}{mirrored}, y {y0:g}..{y1:g}, "
            f"z {z0:g}..{z1:g}); correct the board's position_mm, or the mount's x_mm, y_mm, z_mm or mirror_x"
        )

    # The tongue is centred on y = 0, like the foot, and always ends at the plate.
    reach = max(0.0, min(-y0, y1))
    foot_end = min(max(x0, _FOOT_END), plate_x0)
    step_end = min(foot_end + _STEP_DEPTH, plate_x0)
    plate = [(plate_x0, y0, z0), (x1, y1, plate_top)]
    bridge = [(foot_end, -reach, z0), (plate_x0, reach, plate_top)]
    step = [(foot_end, -reach, z0), (step_end, reach, z1)]
    over_foot = [(x0, -reach, _FOOT_TOP), (foot_end, reach, z1)]
    vertices, faces = union_of_boxes([plate, bridge, step, over_foot])
    vertices /= 1000
    if mirror_x:
        return vertices * (-1.0, 1.0, 1.0), np.ascontiguousarray(faces[:, ::-1])
    return vertices, faces


def union_of_boxes(boxes: ArrayLike) -> tuple[Array, Faces]:
    """Return the closed surface of the union of axis-aligned boxes (k, 2, 3), each a low and a high corner.

    The faces of all boxes divide space into cells. The surface has a quad between each full cell and empty neighbour.
    """
    corners = np.asarray(boxes, dtype=np.float64)
    corners = corners[(corners[:, 0] < corners[:, 1]).all(axis=1)]
    cuts = [np.unique(corners[..., axis]) for axis in range(3)]
    centres = np.stack(np.meshgrid(*[(cut[1:] + cut[:-1]) / 2 for cut in cuts], indexing="ij"), axis=-1)
    inside = [((low < centres) & (centres < high)).all(axis=-1) for low, high in corners]
    full = np.pad(np.any(inside, axis=0), 1)

    grid = tuple(len(cut) for cut in cuts)
    quads = []
    for axis in range(3):
        across = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        around = np.array([0 * across[0], across[0], across[0] + across[1], across[1]])
        for side in (0, 1):
            outside = np.roll(full, 1 - 2 * side, axis)
            cells = np.argwhere(full & ~outside) - 1  # without the padding
            corner = cells[:, None, :] + around + side * np.eye(3, dtype=int)[axis]
            quads.append(corner if side else corner[:, ::-1])
    numbers, quad = np.unique(np.ravel_multi_index(np.concatenate(quads).T, grid).T, return_inverse=True)
    quad = quad.reshape(-1, 4)
    vertices = np.stack([cut[k] for cut, k in zip(cuts, np.unravel_index(numbers, grid), strict=True)], axis=-1)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    return vertices, faces.astype(np.int32)
