"""How a print's picture differs from the photo, and how the difference changes with its smear and its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry.se3 import Array
from .print_view import Drawing, PrintView, draw_print
from .smear import Smear, slopes_of

# A tile of fewer pixels says nothing about its own brightness.
_MIN_TILE_PIXELS = 12
# A tile into which less than this is smeared from beside the print (sum of squared shares) is not touched by it.
_LEAST_BESIDE = 1e-4
# A tile with less contrast (grey levels) shows no print beside which anything could be bright.
_LEAST_CONTRAST = 1.0


@dataclass(frozen=True)
class Tile:
    """A marker and half the gap around it.

    Attributes:
        correlation: of drawing and photo, -1..1.
        shift: how far (px, right and down) the photo has it from where the drawing has it.
        shifted: how much of the photo that the drawing leaves unexplained the shift would explain, grey levels squared.
        unexplained: what it would leave, mean square, grey levels squared.
    """

    correlation: float
    shift: tuple[float, float]
    shifted: float
    unexplained: float


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
    view: PrintView, plane: Array, smear: Smear, columns: Callable[[Pixels], Array]
) -> tuple[Array, Array, dict[int, Tile]] | None:
    """Residuals and their Jacobian without each tile's brightness and contrast, and how the tiles agree.

    Args:
        plane: where the print lies, as for `draw_print`.
        smear: in the photo's pixels.
        columns: the drawing's derivatives (n, k) by whatever moves the print.

    Returns:
        Residuals (n,), Jacobian (n, 3 + k) by the blur, by the motion and by that, and for each marker its tile; None
        where too few pixels show the print.
    """
    smear = smear.in_larger_pixels(view.coarser)
    drawing = draw_print(view, plane, smear)
    tile = _tiles(view, drawing)
    use = tile >= 0
    if use.sum() < 3 * _MIN_TILE_PIXELS:
        return None
    seen, drawn = view.photo.ravel()[use], drawing.grey.ravel()[use]
    beside = np.zeros((len(seen), 0), np.float32)
    slopes, by_blur, by_motion = _changes(drawing.sharp, drawing.grey, smear, use)
    if drawing.beside is not None and drawing.outside is not None:
        beside = drawing.beside.reshape(-1, 2)[use]
        # What lies beside the print is smeared into it by the same lens, and moves with it.
        for side, strength in enumerate(_strengths(seen, drawn, beside, tile[use]).T):
            outside, smeared = (np.ascontiguousarray(every[..., side]) for every in (drawing.outside, drawing.beside))
            more = _changes(outside, smeared, smear, use)
            slopes, by_blur, by_motion = (
                of_print + strength.reshape(-1, *[1] * (of_print.ndim - 1)) * of_side
                for of_print, of_side in zip((slopes, by_blur, by_motion), more, strict=True)
            )
    by_ray = (-slopes[:, None, :] @ view.px_per_ray[use])[:, 0]
    pixels = Pixels(drawing.at[use], view.centre_rays[use], by_ray, -slopes / view.coarser)
    by_all = np.column_stack([by_blur / view.coarser, by_motion / view.coarser, columns(pixels), pixels.by_shift])
    return _without_light(seen, drawn, beside, by_all, tile[use])


def _changes(
    sharp: NDArray[np.float32], smeared: NDArray[np.float32], smear: Smear, use: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Of a picture's pixels (n,) in use: slopes (n, 2), and changes with the blur (n,) and with the motion (n, 2)."""
    slopes = np.stack([slope.ravel()[use] for slope in slopes_of(smeared)], axis=-1).astype(np.float64)
    by_blur = smear.by_blur(sharp, smeared).ravel()[use].astype(np.float64)
    by_motion = np.zeros((len(by_blur), 2))
    if smear.length:
        by_motion[:] = np.stack([by.ravel()[use] for by in smear.by_motion(sharp)], axis=-1)
    return slopes, by_blur, by_motion


def _strengths(
    photo: NDArray[np.float32], drawn: NDArray[np.float32], beside: NDArray[np.float32], tile: NDArray[np.int_]
) -> Array:
    """How bright (n, sides) what lies beside the print is at each pixel's tile, in the print's own contrast."""
    order = np.argsort(tile, kind="stable")
    _, starts, which = np.unique(tile[order], return_index=True, return_inverse=True)
    every = np.column_stack([drawn, beside, photo])[order].astype(np.float64)
    every -= (np.add.reduceat(every, starts) / np.bincount(which)[:, None])[which]
    shapes = every.shape[1] - 1
    first, second = np.tril_indices(shapes + 1)
    products = np.zeros((len(starts), shapes + 1, shapes + 1))
    products[:, first, second] = np.add.reduceat(every[:, first] * every[:, second], starts)
    products[:, second, first] = products[:, first, second]
    # Sides that hardly touch a tile are left out of its equations.
    power = np.einsum("tkk->tk", products[:, 1:shapes, 1:shapes])
    touched = np.column_stack([np.ones(len(starts), dtype=bool), power > _LEAST_BESIDE])
    normal = products[:, :shapes, :shapes] * touched[:, :, None] * touched[:, None, :]
    normal += np.eye(shapes) * np.where(touched, 1e-9, 1.0)[:, None, :]
    found = np.linalg.solve(normal, (products[:, :shapes, shapes] * touched)[..., None])[..., 0]
    contrast = found[:, :1]
    of_tile = np.where(contrast > _LEAST_CONTRAST, found[:, 1:] / np.maximum(contrast, _LEAST_CONTRAST), 0.0)
    strengths = np.empty(beside.shape)
    strengths[order] = of_tile[which]
    return strengths


def _tiles(view: PrintView, drawing: Drawing) -> NDArray[np.int_]:
    """The marker (n,) each pixel shows, -1 for none: markers of too few pixels are left out."""
    board, marker = view.piece.board, drawing.marker.copy()
    counts = np.bincount(marker[marker >= 0], minlength=board.rows * board.columns)
    marker[~np.append(counts >= _MIN_TILE_PIXELS, False)[marker]] = -1
    return marker


def _without_light(
    photo: NDArray[np.float32],
    drawn: NDArray[np.float32],
    beside: NDArray[np.float32],
    columns: Array,
    tile: NDArray[np.int_],
) -> tuple[Array, Array, dict[int, Tile]]:
    """Residuals and Jacobian once each tile's best light is taken out (variable projection).

    That is its brightness, its contrast, and what is smeared into it from beside the print. The last two columns are by
    a shift in the picture: they tell each tile's own, and are left out of the Jacobian.
    """
    order = np.argsort(tile, kind="stable")
    numbers, starts, which = np.unique(tile[order], return_index=True, return_inverse=True)

    def of_tiles(values: Array) -> Array:
        """Sums (t, ...) over each tile's pixels."""
        return np.add.reduceat(values, starts, axis=0)

    # Photo, drawing and its derivatives, less each tile's mean and what comes from beside the print.
    every = np.column_stack([beside, photo, drawn, columns])[order].astype(np.float64)
    every -= (of_tiles(every) / of_tiles(np.ones(len(every)))[:, None])[which]
    sides = beside.shape[1]
    for side in range(sides):
        strange = every[:, side].copy()
        power = of_tiles(strange**2)
        share = of_tiles(every * strange[:, None]) / np.maximum(power, _LEAST_BESIDE)[:, None]
        share[power < _LEAST_BESIDE] = 0.0
        every -= strange[:, None] * share[which]
    every = every[:, sides:]
    seen, shape, slopes = every[:, 0], every[:, 1], every[:, 2:]
    along = of_tiles(every * shape[:, None])
    power = along[:, 1] + 1e-9
    contrast = along[:, 0] / power
    slopes = contrast[which, None] * (slopes - shape[:, None] * (along[:, 2:] / power[:, None])[which])
    residual = seen - contrast[which] * shape
    (x, y), rest = slopes[:, -2:].T, residual
    xx, xy, yy, xr, yr = of_tiles(np.column_stack([x * x, x * y, y * y, x * rest, y * rest])).T
    xx, yy = xx + 1e-6, yy + 1e-6
    shifts = np.column_stack([yy * xr - xy * yr, xx * yr - xy * xr]) / (xx * yy - xy**2)[:, None]
    correlation = contrast * np.sqrt(power / (of_tiles(seen**2) + 1e-9))
    shifted = shifts[:, 0] * xr + shifts[:, 1] * yr
    unexplained = (of_tiles(residual**2) - shifted) / of_tiles(np.ones(len(residual)))
    tiles = {
        int(number): Tile(float(alike), (float(right), float(down)), float(gain), float(left))
        for number, alike, (right, down), gain, left in zip(
            numbers, correlation, shifts, shifted, unexplained, strict=True
        )
    }
    return residual, slopes[:, :-2], tiles
