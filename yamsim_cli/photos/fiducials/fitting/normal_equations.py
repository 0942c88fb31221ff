"""Residuals of a rendered print against the photo, their Jacobian, and robust normal equations."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.least_squares import LeastSquares, solve_least_squares

from .blur_kernel import BlurKernel, picture_gradients
from .print_view import PhotoRegion, RenderedPrint, render_print

_MIN_TILE_PIXELS = 12  # below, a tile (a marker and half its gap) is not compared
_MIN_SURROUNDINGS_POWER = 1e-4  # sum of a tile's squared pixel shares outside the print; smaller sums are ignored
_MIN_CONTRAST = 1.0  # grey levels; below, a tile shows no print

_HUBER_THRESHOLD = 1.345  # standard deviations, beyond which residuals have less weight (95 % efficiency)
_MIN_NOISE = 0.3  # grey levels, from rounding alone
_MAX_STEPS = 30
# A step below either ends a fit: print shift, px, and standard deviations of the noise.
_CONVERGENCE_LIMITS = (4e-3, 0.1)
_COARSE_CONVERGENCE_LIMITS = (2e-2, 0.4)  # the same for a coarse fit, which needs only the cost
_MIN_RETRIED_STEP = 1.0  # standard deviations of the noise; a coarse fit ends if a smaller step fails


@dataclass(frozen=True)
class MarkerTile:
    """The agreement of rendered print and photo at a tile: a marker and half the gap around it.

    Attributes:
        correlation: -1..1.
        shift: offset (right, down) of the photo from the rendering, px.
        residual_variance: after that shift, grey levels squared.
    """

    correlation: float
    shift: tuple[float, float]
    residual_variance: float


@dataclass(frozen=True)
class PixelDerivatives:
    """Compared pixels and derivatives of the print's brightness there.

    Attributes:
        board_points: on the board (n, 2), m.
        rays: viewing rays (n, 2).
        brightness_by_ray, brightness_by_shift: (n, 2) by a print shift in ray units, and in px.
    """

    board_points: Array
    rays: Array
    brightness_by_ray: Array
    brightness_by_shift: Array


def linearize_print(
    view: PhotoRegion, plane: Array, blur: BlurKernel, columns: Callable[[PixelDerivatives], Array]
) -> tuple[Array, Array, dict[int, MarkerTile]] | None:
    """Return residuals (n,), Jacobian (n, 3 + k) and tiles by marker; None if few pixels show the print.

    Each tile's brightness and contrast are projected out. Columns: blur, motion and k parameters.

    Args:
        plane: (3, 3) from (x, y, 1) on the board, m, to the camera frame.
        blur: in the photo's pixels.
        columns: returns the print's derivatives (n, k) by the parameters that move it.
    """
    blur = blur.scaled_to_reduced_picture(view.reduction_factor)
    drawing = render_print(view, plane, blur)
    tile = _pixel_tiles(view, drawing)
    use = tile >= 0
    if use.sum() < 3 * _MIN_TILE_PIXELS:
        return None
    seen, drawn = view.photo.ravel()[use], drawing.grey.ravel()[use]
    beside = np.zeros((len(seen), 0), np.float32)
    slopes, by_blur, by_motion = _picture_derivatives(drawing.unblurred, drawing.grey, blur, use)
    if drawing.blurred_outside_share is not None and drawing.outside_share is not None:
        beside = drawing.blurred_outside_share.reshape(-1, 2)[use]
        # The blur also mixes in the surroundings, which move with the print.
        for side, strength in enumerate(_surroundings_brightness(seen, drawn, beside, tile[use]).T):
            outside, smeared = (
                np.ascontiguousarray(every[..., side])
                for every in (drawing.outside_share, drawing.blurred_outside_share)
            )
            more = _picture_derivatives(outside, smeared, blur, use)
            slopes, by_blur, by_motion = (
                of_print + strength.reshape(-1, *[1] * (of_print.ndim - 1)) * of_side
                for of_print, of_side in zip((slopes, by_blur, by_motion), more, strict=True)
            )
    brightness_by_ray = (-slopes[:, None, :] @ view.px_per_ray[use])[:, 0]
    pixels = PixelDerivatives(
        drawing.board_points[use], view.centre_rays[use], brightness_by_ray, -slopes / view.reduction_factor
    )
    by_all = np.column_stack(
        [
            by_blur / view.reduction_factor,
            by_motion / view.reduction_factor,
            columns(pixels),
            pixels.brightness_by_shift,
        ]
    )
    return _eliminate_tile_brightness(seen, drawn, beside, by_all, tile[use])


def _picture_derivatives(
    sharp: NDArray[np.float32], blurred: NDArray[np.float32], blur: BlurKernel, use: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    slopes = np.stack([slope.ravel()[use] for slope in picture_gradients(blurred)], axis=-1).astype(np.float64)
    by_blur = blur.blur_derivative(sharp, blurred).ravel()[use].astype(np.float64)
    by_motion = np.zeros((len(by_blur), 2))
    if blur.motion_length:
        by_motion[:] = np.stack([by.ravel()[use] for by in blur.motion_derivatives(sharp)], axis=-1)
    return slopes, by_blur, by_motion


def _surroundings_brightness(
    photo: NDArray[np.float32], drawn: NDArray[np.float32], outside_shares: NDArray[np.float32], tile: NDArray[np.int_]
) -> Array:
    order = np.argsort(tile, kind="stable")
    _, starts, which = np.unique(tile[order], return_index=True, return_inverse=True)
    every = np.column_stack([drawn, outside_shares, photo])[order].astype(np.float64)
    every -= (np.add.reduceat(every, starts) / np.bincount(which)[:, None])[which]
    shapes = every.shape[1] - 1
    first, second = np.tril_indices(shapes + 1)
    products = np.zeros((len(starts), shapes + 1, shapes + 1))
    products[:, first, second] = np.add.reduceat(every[:, first] * every[:, second], starts)
    products[:, second, first] = products[:, first, second]
    # Exclude sides that hardly affect a tile.
    power = np.einsum("tkk->tk", products[:, 1:shapes, 1:shapes])
    touched = np.column_stack([np.ones(len(starts), dtype=bool), power > _MIN_SURROUNDINGS_POWER])
    normal = products[:, :shapes, :shapes] * touched[:, :, None] * touched[:, None, :]
    normal += np.eye(shapes) * np.where(touched, 1e-9, 1.0)[:, None, :]
    found = np.linalg.solve(normal, (products[:, :shapes, shapes] * touched)[..., None])[..., 0]
    contrast = found[:, :1]
    of_tile = np.where(contrast > _MIN_CONTRAST, found[:, 1:] / np.maximum(contrast, _MIN_CONTRAST), 0.0)
    strengths = np.empty(outside_shares.shape)
    strengths[order] = of_tile[which]
    return strengths


def _pixel_tiles(view: PhotoRegion, drawing: RenderedPrint) -> NDArray[np.int_]:
    board, marker = view.piece.board, drawing.marker.copy()
    counts = np.bincount(marker[marker >= 0], minlength=board.rows * board.columns)
    marker[~np.append(counts >= _MIN_TILE_PIXELS, False)[marker]] = -1
    return marker


def _eliminate_tile_brightness(
    photo: NDArray[np.float32],
    drawn: NDArray[np.float32],
    outside_shares: NDArray[np.float32],
    columns: Array,
    tile: NDArray[np.int_],
) -> tuple[Array, Array, dict[int, MarkerTile]]:
    """Return residuals, Jacobian and tiles, with each tile's light projected out (variable projection).

    Light is brightness, contrast and surroundings of shares `outside_shares` (n, sides). The last two `columns`,
    derivatives by a picture shift, give the tiles' shifts and are not returned.
    """
    order = np.argsort(tile, kind="stable")
    numbers, starts, which = np.unique(tile[order], return_index=True, return_inverse=True)

    def sum_per_tile(values: Array) -> Array:
        return np.add.reduceat(values, starts, axis=0)

    # Subtract tile means and surroundings from photo, rendering and derivatives.
    every = np.column_stack([outside_shares, photo, drawn, columns])[order].astype(np.float64)
    every -= (sum_per_tile(every) / sum_per_tile(np.ones(len(every)))[:, None])[which]
    sides = outside_shares.shape[1]
    for side in range(sides):
        outside_share = every[:, side].copy()
        power = sum_per_tile(outside_share**2)
        share = sum_per_tile(every * outside_share[:, None]) / np.maximum(power, _MIN_SURROUNDINGS_POWER)[:, None]
        share[power < _MIN_SURROUNDINGS_POWER] = 0.0
        every -= outside_share[:, None] * share[which]
    every = every[:, sides:]
    seen, shape, slopes = every[:, 0], every[:, 1], every[:, 2:]
    along = sum_per_tile(every * shape[:, None])
    power = along[:, 1] + 1e-9
    contrast = along[:, 0] / power
    slopes = contrast[which, None] * (slopes - shape[:, None] * (along[:, 2:] / power[:, None])[which])
    residual = seen - contrast[which] * shape
    (x, y), rest = slopes[:, -2:].T, residual
    xx, xy, yy, xr, yr = sum_per_tile(np.column_stack([x * x, x * y, y * y, x * rest, y * rest])).T
    xx, yy = xx + 1e-6, yy + 1e-6
    shifts = np.column_stack([yy * xr - xy * yr, xx * yr - xy * xr]) / (xx * yy - xy**2)[:, None]
    correlation = contrast * np.sqrt(power / (sum_per_tile(seen**2) + 1e-9))
    shifted = shifts[:, 0] * xr + shifts[:, 1] * yr
    unexplained = (sum_per_tile(residual**2) - shifted) / sum_per_tile(np.ones(len(residual)))
    tiles = {
        int(number): MarkerTile(float(alike), (float(right), float(down)), float(left))
        for number, alike, (right, down), left in zip(numbers, correlation, shifts, unexplained, strict=True)
    }
    return residual, slopes[:, :-2], tiles


LinearizedPrint = tuple[Array, Array, dict[int, MarkerTile]]  # of one board: residuals, Jacobian, marker -> tile
S = TypeVar("S")


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations over all parameters, with statistics of the residuals.

    Attributes:
        full_normal, full_right_hand_side: (k, k) and (k,), over all parameters.
        misfit: weighted sum of squared residuals, grey levels squared.
        weight: sum of the weights.
        noise: sigma of the residuals, grey levels, assumed for the weights or estimated.
        tiles: marker -> tile, for each board.
        free_parameters: indices of the fitted parameters.
    """

    full_normal: Array
    full_right_hand_side: Array
    misfit: float
    weight: float
    pixels: int
    noise: float
    tiles: tuple[dict[int, MarkerTile], ...]
    free_parameters: tuple[int, ...]

    @property
    def normal_matrix(self) -> Array:
        """The matrix (f, f) over the fitted parameters."""
        return self.full_normal[np.ix_(self.free_parameters, self.free_parameters)]

    @property
    def right_hand_side(self) -> Array:
        """The right-hand side (f,) over the fitted parameters."""
        return self.full_right_hand_side[list(self.free_parameters)]

    @property
    def cost(self) -> float:
        """The weighted mean squared residual. A mean does not favour poses with fewer pixels."""
        return self.misfit / self.weight


class PrintProblem(LeastSquares[S, NormalEquations]):
    """Least squares over prints' pixels. With `roughly`, the fit stops early, as it needs only the cost."""

    def __init__(self, roughly: bool = False) -> None:
        self._roughly = roughly

    @abstractmethod
    def equations_at(self, state: S, noise: float | None) -> NormalEquations | None:
        """Return the equations at a state; if `noise` is None, the residuals give the noise for the weights."""

    @abstractmethod
    def print_shift_px(self, state: S, step: Array) -> float:
        """Return the approximate print shift in the picture by a step (f,), px."""

    def linearize(self, state: S, before: NormalEquations | None) -> NormalEquations | None:
        """Return the equations, with weights for the noise of the state before."""
        if before is None:
            return self.equations_at(state, None)
        found = self.equations_at(state, before.noise)
        if found is None:
            return None
        # New noise changes weights only at the next state: both costs of a step need the same weights.
        return replace(found, noise=float(np.sqrt(found.misfit / max(1.0, found.weight - 7))))

    def is_converged(self, state: S, known: NormalEquations, step: Array, gain: Array) -> bool:
        """Return whether the last step hardly moved the print."""
        px, sigmas = _COARSE_CONVERGENCE_LIMITS if self._roughly else _CONVERGENCE_LIMITS
        of_noise = math.sqrt(max(float(step @ known.normal_matrix @ step), 0.0)) / max(known.noise, _MIN_NOISE)
        if self._roughly and gain < 0 and of_noise < _MIN_RETRIED_STEP:
            return True
        return of_noise < sigmas or self.print_shift_px(state, step) < px

    def solve(self, start: S) -> tuple[S, NormalEquations] | None:
        """Return the best state near a start; None if the photo does not show the print."""
        return solve_least_squares(self, start, _MAX_STEPS)


def combine_equations(
    parts: Sequence[LinearizedPrint | None], noise: float | None, free: tuple[int, ...]
) -> NormalEquations | None:
    """Return the normal equations of all boards; None if a board is not visible."""
    whole = [part for part in parts if part is not None]
    if len(whole) < len(parts):
        return None
    residual = np.concatenate([part[0] for part in whole])
    jacobian = np.concatenate([part[1] for part in whole])
    if noise is None:
        noise = float(1.4826 * np.median(np.abs(residual)))
    noise = max(noise, _MIN_NOISE)
    weight = np.minimum(1.0, _HUBER_THRESHOLD * noise / np.maximum(np.abs(residual), 1e-9))
    weighted = jacobian * weight[:, None]
    return NormalEquations(
        weighted.T @ jacobian + 1e-12 * np.eye(jacobian.shape[1]),
        weighted.T @ residual,
        float(weight @ residual**2),
        float(weight.sum()),
        len(residual),
        noise,
        tuple(part[2] for part in whole),
        free,
    )
