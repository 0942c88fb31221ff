"""How a print's picture differs from the photo, and how the difference changes with the blur and with where it lies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...geometry.se3 import Array
from .print_view import Drawing, PrintView, draw_print

# A tile of fewer pixels says nothing about its own brightness.
_MIN_TILE_PIXELS = 12


@dataclass(frozen=True)
class Tile:
    """A marker and half the gap around it.

    Attributes:
        correlation: of drawing and photo, -1..1.
        shift: how far (px, right and down) the photo has it from where the drawing has it.
    """

    correlation: float
    shift: tuple[float, float]


@dataclass(frozen=True)
class Pixels:
    """The pixels that are compared, and how the drawn print changes there.

    Attributes:
        at: where on the board (n, 2) each lies, in m of the board's own measures.
        rays: their viewing rays (n, 2).
        by_ray, by_shift: the drawing's derivative (n, 2) by a shift of the print along the rays, and by one in px.
    """

    at: Array
    rays: Array
    by_ray: Array
    by_shift: Array


def linearized(
    view: PrintView, plane: Array, blur: float, columns: Callable[[Pixels], Array]
) -> tuple[Array, Array, dict[int, Tile]] | None:
    """Residuals and their Jacobian without each tile's brightness and contrast, and how the tiles agree.

    Args:
        plane: where the print lies, as for `draw_print`.
        blur: sigma, px of the photo.
        columns: the drawing's derivatives (n, k) by whatever moves the print.

    Returns:
        Residuals (n,), Jacobian (n, 1 + k) by the blur and by that, and for each marker its tile; None where too few
        pixels show the print.
    """
    blur /= view.coarser
    drawing = draw_print(view, plane, blur)
    tile = _tiles(view, drawing)
    use = tile >= 0
    if use.sum() < 3 * _MIN_TILE_PIXELS:
        return None
    grey = drawing.grey
    slopes = np.stack([cv2.Scharr(grey, cv2.CV_32F, 1, 0), cv2.Scharr(grey, cv2.CV_32F, 0, 1)], axis=-1) / 32
    curvature = cv2.Laplacian(grey, cv2.CV_32F, ksize=1)
    by_own_px = -slopes.reshape(-1, 2)[use].astype(np.float64)
    by_ray = (by_own_px[:, None, :] @ view.px_per_ray[use])[:, 0]
    pixels = Pixels(drawing.at[use], view.centre_rays[use], by_ray, by_own_px / view.coarser)
    # Blur spreads as heat does.
    by_blur = blur * curvature.ravel()[use] / view.coarser
    by_all = np.column_stack([by_blur, columns(pixels), pixels.by_shift])
    return _without_light(view.photo.ravel()[use], grey.ravel()[use], by_all, tile[use])


def _tiles(view: PrintView, drawing: Drawing) -> NDArray[np.int_]:
    """The marker (n,) each pixel shows, -1 for none: markers of too few pixels are left out."""
    board, marker = view.piece.board, drawing.marker.copy()
    counts = np.bincount(marker[marker >= 0], minlength=board.rows * board.columns)
    marker[~np.append(counts >= _MIN_TILE_PIXELS, False)[marker]] = -1
    return marker


def _without_light(
    photo: NDArray[np.float32], drawn: NDArray[np.float32], columns: Array, tile: NDArray[np.int_]
) -> tuple[Array, Array, dict[int, Tile]]:
    """Residuals and Jacobian once each tile's best brightness and contrast are taken out (variable projection).

    The last two columns are by a shift in the picture: they tell each tile's own, and are left out of the Jacobian.
    """
    order = np.argsort(tile, kind="stable")
    residual, jacobian = np.empty(len(tile)), np.empty((len(tile), columns.shape[1] - 2))
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
        jacobian[index] = slopes[:, :-2]
        by_shift = slopes[:, -2:]
        shift = np.linalg.solve(by_shift.T @ by_shift + 1e-6 * np.eye(2), by_shift.T @ residual[index])
        correlation = contrast * np.sqrt(power / (float(seen @ seen) + 1e-9))
        tiles[int(number)] = Tile(float(correlation), (float(shift[0]), float(shift[1])))
    return residual, jacobian, tiles
