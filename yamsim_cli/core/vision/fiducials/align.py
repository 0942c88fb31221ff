"""Refine a pose by the boards' whole picture rather than by a few corners.

The boards' print is known to the last cell. So it is drawn as the camera would see it from a supposed pose, blurred as
the lens blurs it, and the pose (and the blur) is moved until drawing and photo agree best: least squares over all
pixels, brightness and contrast free for each marker, outlying pixels weighted down. Corners found one by one lie on
blurred black-to-white edges and are pushed about by their neighbours; here neighbours and blur are part of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, pose, rotation_from_vector
from .print_view import Drawing, Piece, PrintView, draw_print, view_print

Grey = NDArray[np.float32]

# Blur (sigma, pixels of a `PrintView`) that is believed: less cannot be told from none, more is no picture of a marker.
BLUR_RANGE = (0.25, 4.0)

# Residuals beyond this many standard deviations count less and less (Huber's 95 % efficiency).
_HUBER = 1.345

_MAX_ITERATIONS = 30
# Steps below this no longer matter: shift of the print in the picture, px.
_CONVERGED_PX = 4e-3

# The least noise (grey levels) that is believed: rounding alone makes as much.
_LEAST_NOISE = 0.3
# The longest step of the zoom, and how far (px) a zoom by one moves the print once the distance has made up for most of
# it.
_ZOOM_STEP = 0.2
_ZOOM_PX = 4.0

# A tile of fewer pixels says nothing about its own brightness.
_MIN_TILE_PIXELS = 12


@dataclass(frozen=True)
class Alignment:
    """How a print and its picture agree.

    Attributes:
        T_ref_in_cam: pose (4, 4).
        covariance: (6, 6) of a small rotation (rad, about the camera's axes) about `centre` and of the shift of
            `centre` (m, along them), from the photo's noise alone.
        by_focal, by_print: (6,) how the pose moves, in the same measure, with the natural logarithm of the focal length
            and of the print's size.
        centre: the point (3,) of the reference frame that these are about: the middle of the pieces.
        blur: sigma, px.
        noise: standard deviation of the residuals, grey levels.
        cost: weighted sum of squared residuals over `pixels` pixels.
        pixels: how many were compared.
        tiles: for each piece, marker -> how drawing and photo agree there.
        zoom, zoom_sigma: natural logarithm of how much longer the focal length is than the camera says, and its
            standard deviation from the noise alone; both 0 where it was not asked for.
    """

    T_ref_in_cam: Array
    covariance: Array
    by_focal: Array
    by_print: Array
    centre: Array
    blur: float
    noise: float
    cost: float
    pixels: int
    tiles: tuple[dict[int, Tile], ...]
    zoom: float = 0.0
    zoom_sigma: float = 0.0


@dataclass(frozen=True)
class Zoom:
    """That the focal length is to be found too: what is known of ln(focal / the camera's) beforehand."""

    mean: float
    sigma: float


@dataclass(frozen=True)
class _State:
    """What is varied: the pose (4, 4), the blur (sigma, px), and the zoom."""

    T: Array
    blur: float
    zoom: float = 0.0


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
class _System:
    """Normal equations over the pose's six parameters, the blur and perhaps the zoom, and what the residuals look like.

    Attributes:
        mixed: products (7, 2) of what pose and blur do to the picture with what the zoom and the print's size do.
    """

    normal: Array
    gradient: Array
    mixed: Array
    cost: float
    weight: float
    pixels: int
    noise: float
    tiles: tuple[dict[int, Tile], ...]


def align(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[Piece],
    T_ref_in_cam: Array,
    blur: float = 0.9,
    zoom: Zoom | None = None,
) -> Alignment | None:
    """Move a pose until the boards' print agrees best with the photo.

    Args:
        photo: grey levels (height, width).
        pieces: what to compare.
        T_ref_in_cam: where to start, right to about a marker's cell.
        blur: where to start, sigma in px.
        zoom: find the focal length too; without, the camera's is taken as it is.

    Returns:
        None where nothing of the pieces lies in the picture, or the fit breaks down.
    """
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit = _Problem(views, _centre(pieces), zoom)
    state, damping = _State(T_ref_in_cam, blur), 1e-3
    system = fit.system(state, noise=None)
    for _ in range(_MAX_ITERATIONS):
        if system is None:
            return None
        damped = system.normal + damping * np.diag(np.diag(system.normal))
        step: Array = np.linalg.solve(damped, system.gradient).astype(np.float64)
        moved = _shift_px(camera, state.T, fit.centre, step[:6]) + _ZOOM_PX * float(np.abs(step[7:]).sum())
        there = fit.moved(state, step)
        trial = fit.system(there, noise=system.noise)
        if trial is not None and trial.cost / trial.weight <= system.cost / system.weight:
            state, damping = there, max(damping / 8, 1e-6)
            system = replace(trial, noise=_noise(trial))
        else:
            damping *= 8
        if moved < _CONVERGED_PX or damping > 1e4:
            break
    return None if system is None else fit.alignment(system, state)


def agreement(
    photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T_ref_in_cam: Array, blur: float, noise: float
) -> Alignment | None:
    """How well the print agrees with the photo at a given pose, which is not moved; residuals weighted for `noise`."""
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit, state = _Problem(views, _centre(pieces), None), _State(T_ref_in_cam, blur)
    system = fit.system(state, noise)
    return None if system is None else fit.alignment(system, state)


def _views(photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T: Array) -> list[PrintView] | None:
    views = [view for piece in pieces if (view := view_print(photo, camera, piece, T)) is not None]
    return views if views and len(views) == len(pieces) else None


def _centre(pieces: Sequence[Piece]) -> Array:
    middle: Array = np.mean([piece.T_board_in_ref[:3, 3] for piece in pieces], axis=0)
    return middle


def _noise(system: _System) -> float:
    return float(np.sqrt(system.cost / max(1.0, system.weight - 7)))


class _Problem:
    """Least squares over the pose's six parameters, the blur, and the zoom where it is sought."""

    def __init__(self, views: Sequence[PrintView], centre: Array, zoom: Zoom | None) -> None:
        self.centre = centre
        self._views = views
        self._zoom = zoom
        self._size = 7 if zoom is None else 8
        coarser = [view.coarser for view in views]
        self._blur_range = (BLUR_RANGE[0] * min(coarser), BLUR_RANGE[1] * max(coarser))

    def system(self, state: _State, noise: float | None) -> _System | None:
        """Normal equations at a state; residuals weighted for a given noise, or for the noise found."""
        parts = [_linearized(view, state, self.centre) for view in self._views]
        whole = [part for part in parts if part is not None]
        if len(whole) < len(parts):
            return None
        residual = np.concatenate([part[0] for part in whole])
        jacobian = np.concatenate([part[1] for part in whole])
        if noise is None:
            noise = float(1.4826 * np.median(np.abs(residual)))
        noise = max(noise, _LEAST_NOISE)
        weight = np.minimum(1.0, _HUBER * noise / np.maximum(np.abs(residual), 1e-9))
        weighted = jacobian * weight[:, None]
        products = weighted.T @ jacobian
        normal = products[: self._size, : self._size] + 1e-12 * np.eye(self._size)
        gradient = (weighted.T @ residual)[: self._size]
        cost = float(weight @ residual**2)
        if self._zoom is not None:
            strength = (noise / self._zoom.sigma) ** 2
            normal[7, 7] += strength
            gradient[7] += strength * (self._zoom.mean - state.zoom)
            cost += strength * (self._zoom.mean - state.zoom) ** 2
        tiles = tuple(part[2] for part in whole)
        return _System(normal, gradient, products[:7, 7:], cost, float(weight.sum()), len(residual), noise, tiles)

    def moved(self, state: _State, step: Array) -> _State:
        """The state a step away."""
        turn = rotation_from_vector(step[:3])
        at = state.T[:3, :3] @ self.centre + state.T[:3, 3]
        R = turn @ state.T[:3, :3]
        blur = float(np.clip(state.blur + step[6], *self._blur_range))
        if self._zoom is None:
            return _State(pose(at + step[3:6] - R @ self.centre, R), blur)
        change = float(np.clip(step[7], -_ZOOM_STEP, _ZOOM_STEP))
        at = at * (1, 1, math.exp(change))
        zoom = state.zoom + change
        return _State(pose(at + step[3:6] - R @ self.centre, R), blur, zoom)

    def alignment(self, system: _System, state: _State) -> Alignment | None:
        """What was found, with its uncertainty; None where the pixels do not determine it."""
        try:
            covariance: Array = np.linalg.inv(system.normal).astype(np.float64) * system.noise**2
            by_focal, by_print = -np.linalg.solve(system.normal[:7, :7], system.mixed)[:6].T
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(covariance).all():
            return None
        # The zoom's column leaves out what the distance makes up for.
        by_focal[5] += (state.T[:3, :3] @ self.centre + state.T[:3, 3])[2]
        zoom_sigma = math.sqrt(max(0.0, covariance[7, 7])) if self._zoom else 0.0
        return Alignment(
            state.T,
            covariance[:6, :6],
            by_focal,
            by_print,
            self.centre,
            state.blur,
            system.noise,
            system.cost,
            system.pixels,
            system.tiles,
            state.zoom,
            zoom_sigma,
        )


def _shift_px(camera: CameraModel, T: Array, centre: Array, step: Array) -> float:
    """About how far a step moves the print in the picture: by the shift, and by the turn of something 0.1 m large."""
    depth = float((T[:3, :3] @ centre + T[:3, 3])[2])
    return float(np.linalg.norm(step[3:6]) + 0.1 * np.linalg.norm(step[:3])) * camera.focal / max(depth, 1e-3)


def _linearized(view: PrintView, state: _State, centre: Array) -> tuple[Array, Array, dict[int, Tile]] | None:
    """Residuals (n,), their Jacobian (n, 9) without each tile's brightness and contrast, and how the tiles agree."""
    blur = state.blur / view.coarser
    drawing = draw_print(view, state.T, blur, math.exp(state.zoom))
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
    columns[:, :6] = _by_pose(view, state, centre, drawing.at[use], by_ray)
    columns[:, 6] = blur * curvature.ravel()[use] / view.coarser
    # A longer lens farther away: the part of the zoom that the distance makes up for is no part of the search.
    depth = float((state.T[:3, :3] @ centre + state.T[:3, 3])[2])
    columns[:, 7] = (by_ray * view.centre_rays[use]).sum(axis=1) + columns[:, 5] * depth
    from_middle = drawing.at[use] @ (state.T[:3, :3] @ view.piece.T_board_in_ref[:3, :2]).T
    columns[:, 8] = (columns[:, 3:6] * from_middle).sum(axis=1)
    columns[:, 9:] = by_shift / view.coarser
    return _without_light(view.photo.ravel()[use], grey.ravel()[use], columns, tile[use])


def _tiles(view: PrintView, drawing: Drawing) -> NDArray[np.int_]:
    """The marker (n,) each pixel shows, -1 for none: markers of too few pixels are left out."""
    board, marker = view.piece.board, drawing.marker.copy()
    counts = np.bincount(marker[marker >= 0], minlength=board.rows * board.columns)
    marker[~np.append(counts >= _MIN_TILE_PIXELS, False)[marker]] = -1
    return marker


def _by_pose(view: PrintView, state: _State, centre: Array, at: Array, by_ray: Array) -> Array:
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
