"""How a print's picture differs from the photo, and how the difference changes with pose, blur and scales."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...geometry.se3 import Array
from .print_view import Drawing, PrintView, draw_print

# A tile of fewer pixels says nothing about its own brightness.
_MIN_TILE_PIXELS = 12


@dataclass(frozen=True)
class State:
    """What is varied: the pose (4, 4), the blur (sigma, px), the zoom, and the print's growth."""

    T: Array
    blur: float
    zoom: float = 0.0
    growth: float = 0.0


@dataclass(frozen=True)
class Tile:
    """A marker and half the gap around it.

    Attributes:
        correlation: of drawing and photo, -1..1.
        shift: how far (px, right and down) the photo has it from where the drawing has it.
    """

    correlation: float
    shift: tuple[float, float]


def linearized(view: PrintView, state: State, centre: Array) -> tuple[Array, Array, dict[int, Tile]] | None:
    """Residuals (n,), their Jacobian (n, 9) without each tile's brightness and contrast, and how the tiles agree."""
    blur = state.blur / view.coarser
    larger = math.exp(state.growth)
    drawing = draw_print(view, state.T, blur, math.exp(state.zoom), larger)
    tile = _tiles(view, drawing)
    use = tile >= 0
    if use.sum() < 3 * _MIN_TILE_PIXELS:
        return None
    grey = drawing.grey
    slopes = np.stack([cv2.Scharr(grey, cv2.CV_32F, 1, 0), cv2.Scharr(grey, cv2.CV_32F, 0, 1)], axis=-1) / 32
    curvature = cv2.Laplacian(grey, cv2.CV_32F, ksize=1)
    # By the pose, by the blur (which spreads as heat does), by zoom and print size, and by a shift in the picture.
    by_shift = -slopes.reshape(-1, 2)[use].astype(np.float64)
    by_ray = np.einsum("ni,nij->nj", by_shift, view.px_per_ray[use])
    columns = np.empty((int(use.sum()), 11))
    columns[:, :6] = _by_pose(view, state, centre, larger * drawing.at[use], by_ray)
    columns[:, 6] = blur * curvature.ravel()[use] / view.coarser
    # A longer lens farther away: the part of the zoom that the distance makes up for is no part of the search.
    depth = float((state.T[:3, :3] @ centre + state.T[:3, 3])[2])
    columns[:, 7] = (by_ray * view.centre_rays[use]).sum(axis=1) + columns[:, 5] * depth
    from_middle = larger * drawing.at[use] @ (state.T[:3, :3] @ view.piece.T_board_in_ref[:3, :2]).T
    columns[:, 8] = (columns[:, 3:6] * from_middle).sum(axis=1)
    columns[:, 9:] = by_shift / view.coarser
    return _without_light(view.photo.ravel()[use], grey.ravel()[use], columns, tile[use])


def _tiles(view: PrintView, drawing: Drawing) -> NDArray[np.int_]:
    """The marker (n,) each pixel shows, -1 for none: markers of too few pixels are left out."""
    board, marker = view.piece.board, drawing.marker.copy()
    counts = np.bincount(marker[marker >= 0], minlength=board.rows * board.columns)
    marker[~np.append(counts >= _MIN_TILE_PIXELS, False)[marker]] = -1
    return marker


def _by_pose(view: PrintView, state: State, centre: Array, at: Array, by_ray: Array) -> Array:
    """Derivative (n, 6) of the drawn print by a turn about `centre` and a shift, at points (n, 2) of the board."""
    R = state.T[:3, :3]
    T_board = view.piece.T_board_in_ref
    from_centre = (np.column_stack([at, np.zeros(len(at))]) @ T_board[:3, :3].T + T_board[:3, 3] - centre) @ R.T
    point = from_centre + R @ centre + state.T[:3, 3]
    depth = point[:, 2]
    # The ray's shift by the point's; the camera's own rays are exp(zoom) times longer.
    by_ray = by_ray * math.exp(state.zoom)
    by_shift = np.column_stack([by_ray, -(by_ray * point[:, :2]).sum(axis=1) / depth]) / depth[:, None]
    return np.column_stack([np.cross(from_centre, by_shift), by_shift])


def _without_light(
    photo: NDArray[np.float32], drawn: NDArray[np.float32], columns: Array, tile: NDArray[np.int_]
) -> tuple[Array, Array, dict[int, Tile]]:
    """Residuals and Jacobian once each tile's best brightness and contrast are taken out (variable projection)."""
    order = np.argsort(tile, kind="stable")
    residual, jacobian = np.empty(len(tile)), np.empty((len(tile), 9))
    numbers, starts = np.unique(tile[order], return_index=True)
    tiles = {}
    for number, index in zip(numbers, np.split(order, starts[1:]), strict=True):
        seen = photo[index].astype(np.float64)
        seen -= seen.mean()
        shape = drawn[index].astype(np.float64)
        shape -= shape.mean()
        slopes = columns[index] - columns[index].mean(axis=0)
        power = float(shape @ shape) + 1e-9
        contrast = float(shape @ seen) / power
        slopes = contrast * (slopes - np.outer(shape, shape @ slopes / power))
        residual[index] = seen - contrast * shape
        jacobian[index] = slopes[:, :9]
        by_shift = slopes[:, 9:]
        shift = np.linalg.solve(by_shift.T @ by_shift + 1e-6 * np.eye(2), by_shift.T @ residual[index])
        correlation = contrast * np.sqrt(power / (float(seen @ seen) + 1e-9))
        tiles[int(number)] = Tile(float(correlation), (float(shift[0]), float(shift[1])))
    return residual, jacobian, tiles
